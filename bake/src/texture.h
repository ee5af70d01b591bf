// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file texture.h
/// Decoding of colour images into Texture, and textures as rays read them (internal to bake).

#include <lumivdb/bake/scene.h>

#include <array>
#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

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

/// A texture as rays read it, in no order: what came from eight bits a channel is eight bits again,
/// in tiles of 4 × 4 that fill a line of the cache. Gives the very values of Texture::sample().
class Texels {
public:
    /// @a texture must outlive this.
    explicit Texels(const Texture& texture);
    std::array<float, 4> sample(float u, float v) const { return sample(find(u, v)); }

    /// The texels that a look-up reads, and the weights of the second column and row.
    struct Footprint {
        std::uint32_t texel[4] = {};
        float right = 0, down = 0;
    };
    Footprint find(float u, float v) const;
    /// Asks memory for what sample() will read.
    void prefetch(const Footprint& at) const
    {
        if (mCodes.empty()) return;
        __builtin_prefetch(&mCodes[at.texel[0]]);
        __builtin_prefetch(&mCodes[at.texel[3]]);
    }
    std::array<float, 4> sample(const Footprint& at) const;
    /// Whether the texture had eight bits a channel.
    bool packed() const { return !mCodes.empty(); }

private:
    std::size_t place(int x, int y) const
    {
        if (mCodes.empty()) {
            return static_cast<std::size_t>(y) * static_cast<std::size_t>(mTexture->width)
                + static_cast<std::size_t>(x);
        }
        const auto tile
            = static_cast<std::size_t>(y >> 2) * mTilesAcross + static_cast<std::size_t>(x >> 2);
        return tile * 16 + static_cast<std::size_t>((y & 3) << 2 | (x & 3));
    }

    const Texture* mTexture;
    std::size_t mTilesAcross = 0;
    std::vector<std::uint32_t> mCodes; // of the texels; empty: the texture's own are read
};

/// IEC 61966-2-1: encoded value in [0, 1] to linear.
float decodeSrgb(float encoded);

} // namespace lumivdb
