// bake/ply.hpp: the cloth as tubes: every pattern becomes a list of plies. draft -> here -> maps.
#pragma once

#include <string>
#include <vector>

#include <glm/glm.hpp>

#include "fabric.hpp"

namespace selvedge
{

// A point of a ply's centre line.
struct PlyPoint {
    glm::vec3 centre_m; // x, y in the tile, z above the mid-plane of the cloth
    float radius_m;     // half width of the ply seen from above
};

// One ply: a tube around a polyline that closes through the tile: its last point is its first one, a period further.
// The section is an ellipse: half width radius, half height aspect * radius. Exactly: the tube is what a ball sweeps
// after z has been scaled by 1/aspect, scaled back.
struct PlyTube {
    std::vector<PlyPoint> points;
    float aspect = 1;
    int yarn = 0; // yarn type
    bool warp = false;
};

struct PlyModel {
    glm::vec2 tile_m{0};
    std::vector<PlyTube> tubes;
};

// What a woven repeat will be, before anything large is made: size, texels, and what had to be bent to fit.
struct WovenPlan {
    Draft repeat; // smallest repeat, repeated to at least 4 threads each way
    std::vector<int> end_type, pick_type;
    std::vector<float> end_spacing_m, pick_spacing_m; // from this thread's axis to the next one's
    std::vector<float> end_width_m, pick_width_m;
    glm::vec2 tile_m{0};
    glm::ivec2 size{0};                 // texels, both even, at most 2048
    int warp_plies = 1, weft_plies = 1; // 1 where plies would be too small to see
    int warp_turns = 0, weft_turns = 0; // signed steps of 1/plies turn over the tile's length; Z positive
    std::vector<std::string> warnings;
};

inline constexpr int side_limit = 2048;   // texels
inline constexpr int texels_per_yarn = 8; // wished for; the resolution is raised for it

//   resolution  texels along the longer side of the tile
//   throws      InputError where even side_limit leaves fewer than 1.5 texels to a yarn
WovenPlan plan_woven(const Fabric& fabric, int resolution);

// Yarn axes in a shallow wave: at every crossing the two yarns touch (z of the upper axis - z of the lower = sum of the
// half heights, shared by `crimp`), a cosine leads from one crossing to the next, floats stay flat. Plies are helices
// about the axis in the space where the section is round.
PlyModel weave_plies(const Fabric& fabric, const WovenPlan& plan);

} // namespace selvedge
