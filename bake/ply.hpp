// bake/ply.hpp: the cloth as tubes: every pattern becomes yarns in space, every yarn its plies. draft, knit -> here ->
// maps.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include <glm/glm.hpp>

#include "fabric.hpp"

namespace selvedge
{

// A yarn in space, woven or knitted: its centre line, its section, its plies and their twist. The line closes through
// the tile: its last point is its first one, one or more periods further.
struct YarnPath {
    struct Point {
        glm::vec3 centre_m;
        float half_width_m; // less where neighbours press; the half height is aspect times it
    };
    std::vector<Point> points; // as fine as plies and texels ask for
    float aspect = 1;
    YarnSection section = YarnSection::ellipse; // racetrack: of a line that is straight, seen from above
    int yarn = 0;                               // yarn type
    bool warp = false;
    int plies = 1;
    int turns = 0;   // signed steps of 1/plies turn from the first point to the last, so that plies close; Z positive
    float phase = 0; // where the first ply starts, in steps of 1/plies turn
};

// A point of a ply's centre line.
struct PlyPoint {
    glm::vec3 centre_m; // x, y in the tile, z above the mid-plane of the cloth
    float radius_m;     // half width of the ply seen from above, before it is drawn out
};

// One ply: a tube around a polyline that closes through the tile: its last point is the first one of a ply of its yarn,
// a period further: its own, or where the plies have changed places over the period, another's. The section is an
// ellipse: half width radius, half height aspect * radius. Exactly: the tube is what a ball sweeps after z has been
// scaled by 1/aspect, scaled back. A race-track section is such a tube drawn out across: all of its points moved by
// every vector from -flat_m to flat_m.
struct PlyTube {
    std::vector<PlyPoint> points;
    float aspect = 1;
    glm::vec2 flat_m{0};
    int yarn = 0; // yarn type
    bool warp = false;
    int thread = 0;                             // which of the yarns it is a ply of
    std::optional<glm::vec3> before_m, after_m; // the points before the first and after the last; absent: its own
};

struct PlyModel {
    glm::vec2 tile_m{0};
    std::vector<PlyTube> tubes;
    // Yarns end in walls, which maps.cpp leans: 0.5 about their middle, for walls no higher than a yarn; 1 outwards
    // from the upper yarn, which keeps its shape where layers of loops lie far apart.
    float wall_share = 0.5f;
    // How much steeper than slope_limit the walls towards gaps may stand, on the yarn: 1 keeps all of their area in the
    // slopes, more keeps the shape of yarns that lie far above the gap's mid-plane.
    float gap_steepness = 1;
};

// Plies as helices about the yarns, in the space where a yarn's section is round. Their angle is measured from a frame
// that is carried along the line without turning about it and is levelled where the line starts: woven yarns, which
// never leave their upright plane, keep it level. Where the line closes with the frame turned, the difference is spread
// over it.
PlyModel wind_plies(glm::vec2 tile_m, const std::vector<YarnPath>& yarns);

// Steps of 1/plies turn over `length_m` so that the plies lean by about `twist_deg` to the yarn; and the lean that so
// many steps give.
int ply_turn_steps(int plies, float twist_deg, float width_m, float length_m);
float ply_twist_of_steps(int steps, int plies, float width_m, float length_m);

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

inline constexpr int side_limit = 2048;             // texels
inline constexpr int texels_per_yarn = 8;           // wished for; the resolution is raised for it
inline constexpr float fewest_texels_for_plies = 6; // across a yarn

//   resolution  texels along the longer side of the tile
//   throws      InputError where even side_limit leaves fewer than 1.5 texels to a yarn
WovenPlan plan_woven(const Fabric& fabric, int resolution);

// Yarn axes in a shallow wave: at every crossing the two yarns touch (z of the upper axis - z of the lower = sum of the
// half heights, shared by `crimp`), over the whole flat part of race-tracks; a cosine leads from one crossing to the
// next, floats stay flat.
std::vector<YarnPath> weave_yarns(const Fabric& fabric, const WovenPlan& plan);

} // namespace selvedge
