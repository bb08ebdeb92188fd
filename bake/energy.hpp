// bake/energy.hpp: where light goes in a yarn: albedos of the slab by angle, what multiple scattering adds, and the
// check that nothing reflects more than it receives. bake.cpp, fabric.cpp and selvedge-bake include it.
#pragma once

#include <glm/glm.hpp>

#include "glsl/cloth_bsdf.hpp"

namespace selvedge
{

// Single scattering by the slab at albedo 1, by direction (math.md 3.3): x reflected R1, y transmitted T1, z
// unscattered U.
//   c_o  cosine of the viewing direction to the slab's normal, (0, 1];  across  |cosine| of its horizontal part to the
//   fibre's perpendicular: 0 looks along the fibre, 1 across it accuracy  quadrature over 48^2 flake normals: 2e-4
//   (tests)
glm::dvec3 slab_albedo(double alpha_r, double alpha_t, double thickness, double c_o, double across);

// R1 averaged over all viewing directions, cosine-weighted.
float mean_slab_reflectance(float alpha, float thickness);

// Light that leaves the slab after two and more scatterings at albedo 1, mean over directions: x reflected, y
// transmitted (math.md 9.2); and the probability of one more scattering after each.
glm::vec2 rescattered_share(float thickness);
float rescattering_probability(float thickness);

// The most that a point of the yarn sends out of what it receives, over all angles and channels: at most 1 if energy is
// kept.
struct YarnEnergy {
    double most = 0;                               // R1 + T1 + diffuse, and U where `unscattered`
    double angle_deg = 0;                          // of the viewing direction where that is
    int channel = 0;                               // 0 red, 1 green, 2 blue
    double slab = 0, diffuse = 0, unscattered = 0; // its parts
};
YarnEnergy yarn_energy(const cloth::f32::ClothYarn& yarn, bool unscattered);

} // namespace selvedge
