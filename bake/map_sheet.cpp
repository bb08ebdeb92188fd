// bake/map_sheet.cpp: drawing the preview sheet and the layers of maps.exr.
#include "map_sheet.hpp"

#include <algorithm>
#include <cmath>

namespace selvedge
{

namespace
{

constexpr float pi = 3.14159265358979f;
constexpr int margin = 6;
constexpr int smallest_panel = 256; // panels are enlarged by whole factors to about this size, or reduced

glm::vec3 hue(float turns) // fully saturated, turns in [0, 1)
{
    const auto channel = [&](float offset) {
        const float t = std::abs(std::fmod(turns + offset, 1.0f) * 6 - 3);
        return std::clamp(t - 1, 0.0f, 1.0f);
    };
    return {channel(0), channel(2.0f / 3), channel(1.0f / 3)};
}

glm::vec3 display(glm::vec3 linear)
{
    return glm::pow(glm::clamp(linear, 0.0f, 1.0f), glm::vec3(1 / 2.2f));
}

std::size_t texel_index(const PackedFabric& fabric, int x, int y)
{
    return static_cast<std::size_t>(y) * static_cast<std::size_t>(fabric.size.x) + static_cast<std::size_t>(x);
}

// s of the 8 knots of the block that holds a texel.
void knots_at(const PackedFabric& fabric, int side, int x, int y, float knots[8])
{
    const std::size_t block =
        static_cast<std::size_t>(y / 2) * static_cast<std::size_t>(fabric.size.x / 2) + static_cast<std::size_t>(x / 2);
    unpack_knots(fabric.side[side].horizons[block], knots);
}

constexpr int panel_count = 6;

glm::vec3 panel_colour(const PackedFabric& fabric, int side, int panel, int x, int y)
{
    const std::size_t i = texel_index(fabric, x, y);
    const Texel texel = unpack_texel(fabric.side[side].texels[i]);
    switch (panel) {
    case 0: { // what the yarn reflects at most, so that drafts look like their colours
        if (texel.gap) return {1, 0, 1};
        const auto& yarn = fabric.yarns[static_cast<std::size_t>(texel.yarn)];
        return display(glm::min(yarn.albedo_r + yarn.diffuse_r, glm::vec3(1)) * (0.25f + 0.75f * texel.irradiance));
    }
    case 1: {
        const glm::vec3 n = glm::normalize(glm::vec3(-texel.slope, 1));
        return n * 0.5f + 0.5f;
    }
    case 2:
        return texel.gap ? glm::vec3(0) : hue(texel.azimuth / pi);
    case 3: {
        const glm::vec2 front = fabric.side[0].height_range_m, back = fabric.side[1].height_range_m;
        const float reach = std::max({-front.x, front.y, -back.x, back.y, 1e-9f});
        return texel.gap ? glm::vec3(0.3f, 0, 0.3f)
                         : glm::vec3(std::clamp(height_m(fabric.side[side], i) / reach * 0.5f + 0.5f, 0.0f, 1.0f));
    }
    case 4:
        return glm::vec3(texel.irradiance);
    default: {
        float knots[8], sum = 0;
        knots_at(fabric, side, x, y, knots);
        for (const float s : knots) sum += s / 8;
        // Two opposite directions against each other: side light shows as red or blue.
        return glm::clamp(glm::vec3(1 - sum) + glm::vec3(knots[4] - knots[0], 0, knots[0] - knots[4]) * 0.5f, 0.0f,
                          1.0f);
    }
    }
}

} // namespace

Image draw_map_sheet(const PackedFabric& fabric)
{
    const int longer = std::max(fabric.size.x, fabric.size.y);
    const int enlarge = std::max(1, smallest_panel / longer), reduce = std::max(1, longer / 512);
    const int w = fabric.size.x / reduce * enlarge, h = fabric.size.y / reduce * enlarge;
    Image sheet(margin + panel_count * (w + margin), margin + 2 * (h + margin), {"R", "G", "B"});
    std::fill(sheet.pixels.begin(), sheet.pixels.end(), 0.15f);
    for (int side = 0; side < 2; ++side)
        for (int panel = 0; panel < panel_count; ++panel)
            for (int y = 0; y < h; ++y)
                for (int x = 0; x < w; ++x) {
                    const int tx = x / enlarge * reduce, ty = y / enlarge * reduce;
                    glm::vec3 colour(0);
                    for (int dy = 0; dy < reduce; ++dy)
                        for (int dx = 0; dx < reduce; ++dx)
                            colour += panel_colour(fabric, side, panel, tx + dx, ty + dy) /
                                      static_cast<float>(reduce * reduce);
                    float* pixel =
                        sheet.at(margin + panel * (w + margin) + x, margin + side * (h + margin) + h - 1 - y);
                    for (int c = 0; c < 3; ++c) pixel[c] = colour[c];
                }
    return sheet;
}

Image map_layers(const PackedFabric& fabric)
{
    std::vector<std::string> names;
    for (const char* side : {"front", "back"}) {
        for (const char* layer : {"height", "slope.x", "slope.y", "azimuth", "yarn", "gap", "irradiance", "stacked"})
            names.push_back(std::string(side) + "." + layer);
        for (int k = 0; k < 8; ++k) names.push_back(std::string(side) + ".horizon" + std::to_string(k));
    }
    Image image(fabric.size.x, fabric.size.y, names);
    for (int y = 0; y < fabric.size.y; ++y)
        for (int x = 0; x < fabric.size.x; ++x) {
            float* out = image.at(x, fabric.size.y - 1 - y);
            for (int side = 0; side < 2; ++side) {
                const std::size_t i = texel_index(fabric, x, y);
                const Texel texel = unpack_texel(fabric.side[side].texels[i]);
                const float height = texel.gap ? 0.0f : height_m(fabric.side[side], i);
                for (const float value : {height, texel.slope.x, texel.slope.y, texel.azimuth,
                                          static_cast<float>(fabric.type_of(texel.yarn)), texel.gap ? 1.0f : 0.0f,
                                          texel.irradiance, fabric.type_of(texel.yarn) != texel.yarn ? 1.0f : 0.0f})
                    *out++ = value;
                knots_at(fabric, side, x, y, out);
                out += 8;
            }
        }
    return image;
}

} // namespace selvedge
