// bake/knit_yarns.hpp: knitted loops as yarns in space. knit, fabric -> here -> ply.
#pragma once

#include <string>
#include <vector>

#include <glm/glm.hpp>

#include "fabric.hpp"
#include "ply.hpp"

namespace selvedge
{

// What a knit will be before anything large is made.
struct KnitPlan {
    KnitPattern pattern;    // smallest repeat, made as large as relaxing it asks for
    int across = 1, up = 1; // times that it is laid side by side, one above another
    float wale_m = 0, row_m = 0, loop_m = 0, width_m = 0;
    glm::vec2 tile_m{0};
    glm::ivec2 size{0}; // texels, both even, at most side_limit
    int plies = 1;      // 1 where plies would be too small to see
    std::vector<std::string> warnings;
};

//   resolution  texels along the longer side of the tile
//   throws      InputError where even side_limit leaves fewer than 1.5 texels to a yarn
KnitPlan plan_knit(const Fabric& fabric, int resolution);

// The yarns of the whole tile, none inside another.
//   start     each loop is Crane's plain-knit curve (t + a sin 2t, h cos t, d cos 2t) (K. Crane, "A Simple Parametric
//             Model of Plain-Knit Yarns", 2023). The sign of its depth is that of the loop's own face at the feet and
//             of its child's face at the head, so that any mixture of knit and purl interlaces
//   length    Peirce's loop, l = 2 c + w + 5.94 d (F. T. Peirce, Textile Research Journal 17, 1947), or as stated
//   rest      rods that keep their length and resist bending and each other (Kaldor, James & Marschner, "Simulating
//             knitted cloth at the yarn level", 2008; Yuksel et al., "Stitch meshes", 2012), here by position-based
//             steps on the periodic tile, while their thickness grows to its full value
//   contact   where yarns still press into each other both are thinned to half their distance: tubes never intersect.
//             `warnings` receives a line where that is more than a tenth
// Deterministic: the same plan gives the same yarns.
std::vector<YarnPath> knit_yarns(const Fabric& fabric, const KnitPlan& plan, std::vector<std::string>& warnings);

} // namespace selvedge
