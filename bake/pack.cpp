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

int PackedFabric::type_of(int yarn) const
{
    const int types = static_cast<int>(yarn_names.size());
    return yarn < types ? yarn : stacks.at(static_cast<std::size_t>(yarn - types)).upper;
}

std::size_t PackedFabric::resident_bytes() const
{
    std::size_t bytes = 0;
    for (int s = 0; s < 2; ++s)
        bytes += side[s].texels.size() * sizeof(glm::uvec2) + side[s].heights.size() * sizeof(std::uint16_t) +
                 visibility_words(*this, s).size() * sizeof(glm::uvec2) + side[s].asg.size() * sizeof(glm::vec4);
    return bytes;
}

double PackedFabric::visibility_bytes_per_texel() const
{
    const std::size_t bytes =
        visibility == VisibilityKind::exact
            ? side[0].heights.size() * sizeof(std::uint16_t)
            : visibility_words(*this, 0).size() * sizeof(glm::uvec2) + side[0].asg.size() * sizeof(glm::vec4);
    return static_cast<double>(bytes) / static_cast<double>(side[0].texels.size());
}

const std::vector<glm::uvec2>& visibility_words(const PackedFabric& fabric, int side)
{
    return fabric.visibility == VisibilityKind::horizon8 ? fabric.side[side].horizons : fabric.side[side].words;
}

int visibility_lookup(VisibilityKind kind)
{
    switch (kind) {
    case VisibilityKind::horizon8:
        return cloth::f32::cloth_visibility_horizon8;
    case VisibilityKind::horizon16:
        return cloth::f32::cloth_visibility_horizon16;
    case VisibilityKind::cap:
        return cloth::f32::cloth_visibility_cap;
    case VisibilityKind::exact:
        return cloth::f32::cloth_visibility_exact;
    case VisibilityKind::asg:
    case VisibilityKind::asg_lsq:
        break;
    }
    return cloth::f32::cloth_visibility_asg;
}

float height_m(const PackedSide& side, std::size_t i)
{
    const glm::vec2 range = side.height_range_m;
    return range.x + (range.y - range.x) * (static_cast<float>(side.heights[i]) / cloth::f32::cloth_height_top);
}

std::vector<float> heights_m(const PackedFabric& fabric, int side)
{
    const std::size_t texels = static_cast<std::size_t>(fabric.size.x) * static_cast<std::size_t>(fabric.size.y);
    std::vector<float> out(texels);
    for (std::size_t i = 0; i < texels; ++i) out[i] = height_m(fabric.side[side], i);
    return out;
}

void pack_heights(const std::vector<float>& heights, PackedSide& side)
{
    const auto [lowest, highest] = std::minmax_element(heights.begin(), heights.end());
    const float low = *lowest, range = std::max(*highest - low, 1e-9f);
    side.height_range_m = {low, low + range};
    side.heights.resize(heights.size());
    for (std::size_t i = 0; i < heights.size(); ++i)
        side.heights[i] = static_cast<std::uint16_t>(
            std::clamp((heights[i] - low) / range, 0.0f, 1.0f) * cloth::f32::cloth_height_top + 0.5f);
}

cloth::f32::ClothMaps maps_of(const PackedFabric& fabric)
{
    cloth::f32::ClothMaps maps;
    maps.size = fabric.size;
    for (int side = 0; side < 2; ++side) {
        maps.texels[side] = fabric.side[side].texels.data();
        maps.horizons[side] = visibility_words(fabric, side).data();
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

glm::uvec2 pack_cap(glm::vec4 mean_gamma, glm::vec2 axes)
{
    const auto axis = [](float a) {
        return static_cast<glm::uint>(
            std::lround(std::clamp(a / cloth::f32::cloth_cap_axis_max, 0.0f, 1.0f) * 2047.0f));
    };
    const float turns = mean_gamma.w / pi;
    const auto gamma = static_cast<glm::uint>(std::lround((turns - std::floor(turns)) * 1024.0f)) & 1023u;
    const glm::vec2 mean = slope_limit * glm::vec2(mean_gamma); // snorm16 is that of slopes
    return {snorm16(mean.x) | snorm16(mean.y) << 16, gamma | axis(axes.x) << 10 | axis(axes.y) << 21};
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
