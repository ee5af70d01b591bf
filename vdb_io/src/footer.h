// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file footer.h
/// The 24 bytes behind OpenVDB's data: see docs/FORMAT.md, "Footer".

#include <array>
#include <cstdint>
#include <string>

namespace lumivdb {

constexpr std::size_t kFooterBytes = 24;
constexpr std::uint32_t kFooterMagic = 0x4644564c; // "LVDF"
/// File-level metadata whose value repeats the file's identity when there is a footer.
constexpr const char* kFooterMarker = "lumivdb_footer";
/// OpenVDB's header: magic, three versions, offset flag, then 36 characters of identity.
constexpr std::size_t kIdentityOffset = 21;
constexpr std::size_t kIdentityBytes = 36;
/// The marker lies within this many bytes of the file's begin.
constexpr std::size_t kMarkerWindow = 65536;

std::array<unsigned char, kFooterBytes> makeFooter(std::uint64_t length, std::uint64_t checksum);

/// @throws Error(Input) when the file has a footer, or says so, and it does not fit the bytes
/// before it; also when the file does not begin as an OpenVDB file does.
void verifyFile(const std::string& path);

} // namespace lumivdb
