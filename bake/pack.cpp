// bake/pack.cpp: the bit layout of texels, slopes and horizon knots.
#include "pack.hpp"

#include <algorithm>
#include <cmath>

namespace selvedge
{

namespace
{

constexpr float pi = 3.14159265358979f;

glm::uint snorm16(float slope)
{
    const float scaled = std::clamp(slope / slope_limit, -1.0f, 1.0f) * 32767.0f;
    return static_cast<glm::uint>(static_cast<std::uint16_t>(static_cast<std::int16_t>(std::lround(scaled))));
}

float from_snorm16(glm::uint bits)
{
    return slope_limit * static_cast<float>(static_cast<std::int16_t>(static_cast<std::uint16_t>(bits))) / 32767.0f;
}

glm::uint unorm8(float value)
{
    return static_cast<glm::uint>(std::lround(std::clamp(value, 0.0f, 1.0f) * 255.0f));
}

} // namespace

std::size_t PackedFabric::resident_bytes() const
{
    std::size_t bytes = 0;
    for (const PackedSide& s : side)
        bytes += s.texels.size() * sizeof(glm::uvec2) + s.horizons.size() * sizeof(glm::uvec2) +
                 s.slope_mips.size() * sizeof(glm::uint) + s.heights.size() * sizeof(std::uint16_t) +
                 s.asg.size() * sizeof(glm::vec4);
    return bytes;
}

cloth::f32::ClothMaps maps_of(const PackedFabric& fabric)
{
    cloth::f32::ClothMaps maps;
    maps.size = fabric.size;
    for (int side = 0; side < 2; ++side) {
        maps.texels[side] = fabric.side[side].texels.data();
        maps.horizons[side] = fabric.side[side].horizons.data();
        maps.mips[side] = fabric.side[side].slope_mips.data();
        maps.heights[side] = fabric.side[side].heights.data();
        maps.asg[side] = fabric.side[side].asg.data();
        maps.height_low[side] = fabric.side[side].height_range_m.x;
        maps.height_high[side] = fabric.side[side].height_range_m.y;
    }
    maps.tile_m = fabric.tile_m;
    maps.noise_cells = fabric.noise_cells;
    maps.noise_amplitude = fabric.noise_amplitude;
    maps.yarns = fabric.yarns.data();
    return maps;
}

glm::uint pack_slope(glm::vec2 slope)
{
    return snorm16(slope.x) | (snorm16(slope.y) << 16);
}

glm::vec2 unpack_slope(glm::uint word)
{
    return {from_snorm16(word & 0xffffu), from_snorm16(word >> 16)};
}

glm::uvec2 pack_texel(const Texel& texel)
{
    float turns = texel.azimuth / pi;
    turns -= std::floor(turns);
    const glm::uint azimuth = static_cast<glm::uint>(std::lround(turns * 65536.0f)) & 0xffffu;
    return {pack_slope(texel.slope), azimuth | (static_cast<glm::uint>(texel.yarn) & 127u) << 16 |
                                         (texel.gap ? 1u << 23 : 0u) | unorm8(texel.irradiance) << 24};
}

Texel unpack_texel(glm::uvec2 words)
{
    Texel texel;
    texel.slope = unpack_slope(words.x);
    texel.azimuth = pi * static_cast<float>(words.y & 0xffffu) / 65536.0f;
    texel.yarn = static_cast<int>(words.y >> 16 & 127u);
    texel.gap = (words.y >> 23 & 1u) != 0;
    texel.irradiance = static_cast<float>(words.y >> 24) / 255.0f;
    return texel;
}

glm::uvec2 pack_knots(const float knots[8])
{
    glm::uvec2 words(0);
    for (int k = 0; k < 8; ++k) words[k / 4] |= unorm8(knots[k]) << (8 * (k % 4));
    return words;
}

void unpack_knots(glm::uvec2 words, float knots[8])
{
    for (int k = 0; k < 8; ++k) knots[k] = static_cast<float>(words[k / 4] >> (8 * (k % 4)) & 255u) / 255.0f;
}

int slope_level_count(glm::ivec2 size)
{
    int levels = 1;
    for (int side = std::max(size.x, size.y); side > 1; side >>= 1) ++levels;
    return levels;
}

glm::ivec2 slope_level_size(glm::ivec2 size, int level)
{
    return {std::max(1, size.x >> level), std::max(1, size.y >> level)};
}

std::size_t slope_level_offset(glm::ivec2 size, int level)
{
    std::size_t offset = 0;
    for (int l = 1; l < level; ++l) {
        const glm::ivec2 s = slope_level_size(size, l);
        offset += static_cast<std::size_t>(s.x) * static_cast<std::size_t>(s.y);
    }
    return offset;
}

} // namespace selvedge
