// bake/maps.hpp: plies projected onto a grid of texels, front and back. ply -> here -> visibility, pack.
#pragma once

#include <cstdint>
#include <vector>

#include <glm/glm.hpp>

#include "ply.hpp"

namespace selvedge
{

// One side's maps, w*h, row 0 at v = 0; the back in the mirrored frame (z negated).
struct SideMaps {
    std::vector<float>
        height_m; // mean over the texel, gaps counting 0; 0 in gap texels; nowhere steeper than slope_limit
    std::vector<glm::vec2> slope;   // its central differences, gap texels included
    std::vector<float> azimuth;     // of the ply's way in the plane, [0, pi)
    std::vector<std::uint8_t> yarn; // type; in gap texels that of the nearest yarn (so is the azimuth)
};

struct FabricMaps {
    glm::ivec2 size{0};
    glm::vec2 tile_m{0};
    SideMaps side[2];              // [0] front, [1] back
    std::vector<std::uint8_t> gap; // 1 where at least half of the texel's samples meet no yarn; the same for both sides
    std::vector<std::uint8_t>
        stacked; // 1 where front and back are, for most samples, two yarns that lie over each other
};

// z-buffer of the tubes with samples x samples rays to a texel, parallel to z, against tubes about smooth curves
// through their points. A texel takes type and azimuth of the yarn that most samples see; azimuths are averaged as
// directions without sign (math.md hazard 15). Slopes are central differences of the height field, so they telescope:
// their mean over the tile is 0 whatever steps the field has (math.md 7), and they fit the visibility that is marched
// over the same heights.
FabricMaps project_plies(const PlyModel& model, glm::ivec2 size, int samples);

// Rays per texel side that suit a size: 4 to 512 texels, 3 to 1024, else 2.
int samples_for(glm::ivec2 size);

// Box means of slopes, levels 1, 2, ... 1x1, as in PackedSide::slope_mips. Each level is averaged from the one before
// with fractional weights, so the mean is kept whatever the size; the last level is the mean over the tile.
std::vector<glm::vec2> slope_mips(const std::vector<glm::vec2>& slope, glm::ivec2 size);

} // namespace selvedge
