// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file gltf_accessor.h
/// Reading of glTF accessors that trusts nothing in the file (internal to bake).

#include "gltf_model.h"

#include <cstddef>
#include <cstdint>
#include <string>

namespace lumivdb {

/// Bytes [begin, begin + size) of a buffer, known to exist.
struct ByteRange {
    const unsigned char* begin = nullptr;
    std::size_t size = 0;
};

/// The bytes of a buffer view. @a what names who asks. @throws Error(Input) out of range.
ByteRange bufferViewBytes(
    const SceneImport& import, const tinygltf::Model& model, int view, const std::string& what);

/// Random access to an accessor's elements: strides, normalised integers and sparse substitution
/// included. Every byte it can touch is checked by the constructor.
class AccessorView {
public:
    /// @a what names the accessor in messages, e.g. "mesh 'wall' primitive 0 POSITION".
    /// @a type is TINYGLTF_TYPE_SCALAR … TINYGLTF_TYPE_VEC4; −1 accepts VEC3 and VEC4.
    /// @throws Error(Input) for any index, size or type that does not fit.
    AccessorView(const SceneImport& import, const tinygltf::Model& model, int accessor, int type,
        const std::string& what);

    std::size_t count() const { return mCount; }
    int components() const { return mComponents; }
    int componentType() const { return mComponentType; }

    /// Component @a c of element @a i as a number (normalised where the accessor says so).
    double value(std::size_t i, int c) const;
    /// Unsigned integer element of a SCALAR accessor.
    std::uint32_t index(std::size_t i) const;

private:
    void bindDense(const SceneImport& import, const tinygltf::Model& model,
        const tinygltf::Accessor& accessor, const std::string& what);
    void bindSparse(const SceneImport& import, const tinygltf::Model& model,
        const tinygltf::Accessor& accessor, const std::string& what);
    const unsigned char* element(std::size_t i) const;

    std::size_t mCount = 0;
    int mComponents = 1;
    int mComponentType = 0;
    std::size_t mElementSize = 0;
    bool mNormalized = false;
    const unsigned char* mData = nullptr; ///< null: zeros
    std::size_t mStride = 0;
    std::size_t mSparseCount = 0;
    int mSparseIndexType = 0;
    const unsigned char* mSparseIndices = nullptr;
    const unsigned char* mSparseValues = nullptr;
};

} // namespace lumivdb
