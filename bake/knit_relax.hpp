// bake/knit_relax.hpp: rods at rest on a periodic tile: length, bending, contact. knit.cpp includes it.
#pragma once

#include <vector>

#include <glm/glm.hpp>

namespace selvedge
{

// Closed rods: strand s is the points start[s] ... start[s + 1] - 1, evenly spaced; after the last one comes the first
// one, a tile width further. Lengths in any unit in which the rods are round and of radius 1.
struct Rods {
    glm::vec2 period{0};
    std::vector<glm::vec3> point;
    std::vector<std::size_t> start;
    std::vector<float> length; // that each strand must have over a period
};

// Brings the rods to rest. Deterministic; input mirrored in z gives mirrored output.
//   effort  share of the full number of steps, (0, 1]
void relax(Rods& rods, float effort = 1);

// For each point half the distance to the nearest part of another strand or, further than a half turn of radius 1 along
// it, of its own; at most 1. Distances are between segments.
std::vector<float> clearances(const Rods& rods);

} // namespace selvedge
