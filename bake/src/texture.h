// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file texture.h
/// Decoding of colour images into Texture (internal to bake).

#include <lumivdb/bake/scene.h>

#include <cstddef>
#include <string>

namespace lumivdb {

/// What sanitising a decoded image changed.
struct TextureDecode {
    bool ok = false;
    std::string reason; ///< why not ok, without a full stop
    bool repaired = false; ///< NaN, infinite or negative values were replaced by 0
};

/// Decodes an encoded image (PNG, JPEG, EXR, HDR, WebP, …) held in memory.
TextureDecode decodeTexture(const unsigned char* bytes, std::size_t size, Texture& texture);

/// Decodes an image file; @a path is UTF-8.
TextureDecode decodeTextureFile(const std::string& path, Texture& texture);

/// IEC 61966-2-1: encoded value in [0, 1] to linear.
float decodeSrgb(float encoded);

} // namespace lumivdb
