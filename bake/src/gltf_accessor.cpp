// SPDX-License-Identifier: Apache-2.0
#include "gltf_accessor.h"

#include <algorithm>
#include <cstring>

namespace lumivdb {

namespace {

/// An accessor without data is all zeros, so nothing else bounds its element count.
constexpr std::size_t kMaxZeroElements = std::size_t(1) << 24;

template <typename T> T load(const unsigned char* p)
{
    T v;
    std::memcpy(&v, p, sizeof(T)); // no alignment is promised
    return v;
}

std::size_t componentSize(int type)
{
    switch (type) {
    case TINYGLTF_COMPONENT_TYPE_BYTE:
    case TINYGLTF_COMPONENT_TYPE_UNSIGNED_BYTE:
        return 1;
    case TINYGLTF_COMPONENT_TYPE_SHORT:
    case TINYGLTF_COMPONENT_TYPE_UNSIGNED_SHORT:
        return 2;
    case TINYGLTF_COMPONENT_TYPE_UNSIGNED_INT:
    case TINYGLTF_COMPONENT_TYPE_FLOAT:
        return 4;
    default:
        return 0; // 5124 and 5130 are not glTF
    }
}

std::uint32_t loadIndex(const unsigned char* p, int type)
{
    switch (type) {
    case TINYGLTF_COMPONENT_TYPE_UNSIGNED_BYTE:
        return *p;
    case TINYGLTF_COMPONENT_TYPE_UNSIGNED_SHORT:
        return load<std::uint16_t>(p);
    default:
        return load<std::uint32_t>(p);
    }
}

bool isIndexType(int type)
{
    return type == TINYGLTF_COMPONENT_TYPE_UNSIGNED_BYTE
        || type == TINYGLTF_COMPONENT_TYPE_UNSIGNED_SHORT
        || type == TINYGLTF_COMPONENT_TYPE_UNSIGNED_INT;
}

const char* typeName(int type)
{
    switch (type) {
    case TINYGLTF_TYPE_SCALAR:
        return "SCALAR";
    case TINYGLTF_TYPE_VEC2:
        return "VEC2";
    case TINYGLTF_TYPE_VEC3:
        return "VEC3";
    case TINYGLTF_TYPE_VEC4:
        return "VEC4";
    default:
        return "VEC3 or VEC4";
    }
}

/// Whether @a count elements of @a size bytes, @a stride apart, fit behind @a offset in @a total.
bool fits(
    std::size_t count, std::size_t size, std::size_t stride, std::size_t offset, std::size_t total)
{
    if (count == 0) return offset <= total;
    if (offset > total || size > total - offset) return false;
    return (count - 1) <= (total - offset - size) / stride;
}

} // namespace

ByteRange bufferViewBytes(
    const SceneImport& import, const tinygltf::Model& model, int view, const std::string& what)
{
    const auto& v = checkedAt(import, model.bufferViews, view, "bufferView", what);
    const auto& data = checkedAt(import, model.buffers, v.buffer, "buffer", what).data;
    if (v.byteOffset > data.size() || v.byteLength > data.size() - v.byteOffset) {
        import.fail(what + ": bufferView " + std::to_string(view) + " reaches beyond buffer "
            + std::to_string(v.buffer) + " (" + std::to_string(data.size()) + " bytes)");
    }
    return {data.data() + v.byteOffset, v.byteLength};
}

AccessorView::AccessorView(const SceneImport& import, const tinygltf::Model& model, int accessor,
    int type, const std::string& what)
{
    const auto& a = checkedAt(import, model.accessors, accessor, "accessor", what);
    const bool typeFits = type == -1
        ? (a.type == TINYGLTF_TYPE_VEC3 || a.type == TINYGLTF_TYPE_VEC4)
        : a.type == type;
    if (!typeFits) {
        import.fail(what + ": accessor " + std::to_string(accessor) + " is not " + typeName(type));
    }
    mCount = a.count;
    mComponents = a.type == TINYGLTF_TYPE_SCALAR ? 1 : a.type;
    mComponentType = a.componentType;
    mNormalized = a.normalized;
    const std::size_t size = componentSize(a.componentType);
    if (size == 0) {
        import.fail(what + ": accessor " + std::to_string(accessor) + " has component type "
            + std::to_string(a.componentType) + ", which glTF does not have");
    }
    mElementSize = size * static_cast<std::size_t>(mComponents);
    bindDense(import, model, a, what + ": accessor " + std::to_string(accessor));
    bindSparse(import, model, a, what + ": accessor " + std::to_string(accessor));
}

void AccessorView::bindDense(const SceneImport& import, const tinygltf::Model& model,
    const tinygltf::Accessor& accessor, const std::string& what)
{
    if (accessor.bufferView < 0) {
        if (mCount > kMaxZeroElements) {
            import.fail(what + " claims " + std::to_string(mCount) + " elements without data");
        }
        return;
    }
    const ByteRange range = bufferViewBytes(import, model, accessor.bufferView, what);
    const std::size_t stride
        = model.bufferViews[static_cast<std::size_t>(accessor.bufferView)].byteStride;
    mStride = stride == 0 ? mElementSize : stride;
    if (mStride < mElementSize) {
        import.fail(what + " has a stride of " + std::to_string(mStride) + " bytes for elements of "
            + std::to_string(mElementSize));
    }
    if (!fits(mCount, mElementSize, mStride, accessor.byteOffset, range.size)) {
        import.fail(what + " (" + std::to_string(mCount) + " elements) reaches beyond bufferView "
            + std::to_string(accessor.bufferView) + " (" + std::to_string(range.size) + " bytes)");
    }
    mData = range.begin + accessor.byteOffset;
}

void AccessorView::bindSparse(const SceneImport& import, const tinygltf::Model& model,
    const tinygltf::Accessor& accessor, const std::string& what)
{
    const auto& sparse = accessor.sparse;
    if (!sparse.isSparse) return;
    if (sparse.count < 1 || static_cast<std::size_t>(sparse.count) > mCount) {
        import.fail(what + " replaces " + std::to_string(sparse.count) + " of "
            + std::to_string(mCount) + " elements");
    }
    if (!isIndexType(sparse.indices.componentType)) {
        import.fail(what + " has sparse indices that are not unsigned integers");
    }
    mSparseCount = static_cast<std::size_t>(sparse.count);
    mSparseIndexType = sparse.indices.componentType;
    const std::size_t indexSize = componentSize(mSparseIndexType);
    const ByteRange indices = bufferViewBytes(import, model, sparse.indices.bufferView, what);
    const ByteRange values = bufferViewBytes(import, model, sparse.values.bufferView, what);
    if (sparse.indices.byteOffset < 0 || sparse.values.byteOffset < 0) {
        import.fail(what + " has a negative sparse offset");
    }
    const auto indexOffset = static_cast<std::size_t>(sparse.indices.byteOffset);
    const auto valueOffset = static_cast<std::size_t>(sparse.values.byteOffset);
    if (!fits(mSparseCount, indexSize, indexSize, indexOffset, indices.size)
        || !fits(mSparseCount, mElementSize, mElementSize, valueOffset, values.size)) {
        import.fail(what + " has sparse data beyond its bufferView");
    }
    mSparseIndices = indices.begin + indexOffset;
    mSparseValues = values.begin + valueOffset;
    for (std::size_t i = 0; i < mSparseCount; ++i) {
        const std::uint32_t at = loadIndex(mSparseIndices + i * indexSize, mSparseIndexType);
        const bool rising
            = i == 0 || at > loadIndex(mSparseIndices + (i - 1) * indexSize, mSparseIndexType);
        if (at >= mCount || !rising) {
            import.fail(what + " has sparse index " + std::to_string(at)
                + " that is out of range or out of sequence");
        }
    }
}

const unsigned char* AccessorView::element(std::size_t i) const
{
    std::size_t low = 0, high = mSparseCount;
    const std::size_t indexSize = mSparseCount > 0 ? componentSize(mSparseIndexType) : 0;
    while (low < high) {
        const std::size_t middle = (low + high) / 2;
        const std::uint32_t at = loadIndex(mSparseIndices + middle * indexSize, mSparseIndexType);
        if (at == i) return mSparseValues + middle * mElementSize;
        if (at < i) {
            low = middle + 1;
        } else {
            high = middle;
        }
    }
    return mData ? mData + i * mStride : nullptr;
}

double AccessorView::value(std::size_t i, int c) const
{
    const unsigned char* p = element(i);
    if (!p) return 0.0;
    p += static_cast<std::size_t>(c) * componentSize(mComponentType);
    switch (mComponentType) {
    case TINYGLTF_COMPONENT_TYPE_FLOAT:
        return load<float>(p);
    case TINYGLTF_COMPONENT_TYPE_UNSIGNED_INT:
        return load<std::uint32_t>(p);
    case TINYGLTF_COMPONENT_TYPE_UNSIGNED_BYTE:
        return mNormalized ? *p / 255.0 : *p;
    case TINYGLTF_COMPONENT_TYPE_UNSIGNED_SHORT: {
        const double v = load<std::uint16_t>(p);
        return mNormalized ? v / 65535.0 : v;
    }
    case TINYGLTF_COMPONENT_TYPE_BYTE: {
        const double v = load<std::int8_t>(p);
        return mNormalized ? std::max(v / 127.0, -1.0) : v;
    }
    default: {
        const double v = load<std::int16_t>(p);
        return mNormalized ? std::max(v / 32767.0, -1.0) : v;
    }
    }
}

std::uint32_t AccessorView::index(std::size_t i) const
{
    const unsigned char* p = element(i);
    return p ? loadIndex(p, mComponentType) : 0;
}

} // namespace lumivdb
