// bake/energy.hpp: where light goes in a yarn: albedos of the slab by angle, what multiple scattering adds, the check
// that nothing reflects more than it receives; and where it goes in the whole cloth, by angle. bake.cpp, fabric.cpp,
// reference/model.cpp, selvedge-bake and the tests' selvedge-ingredients include it.
#pragma once

#include <glm/glm.hpp>

#include "fabric.hpp"
#include "glsl/cloth_bsdf.hpp"
#include "pack.hpp"

namespace selvedge
{

// Single scattering by the slab at albedo 1, by direction (math.md 3.3): x reflected R1, y transmitted T1, z
// unscattered U.
//   c_o  cosine of the viewing direction to the slab's normal, (0, 1];  across  |cosine| of its horizontal part to the
//   fibre's perpendicular: 0 looks along the fibre, 1 across it accuracy  quadrature over 48^2 flake normals: 2e-4
//   (tests)
glm::dvec3 slab_albedo(double alpha_r, double alpha_t, double thickness, double c_o, double across);

// slab_albedo of a yarn at albedo 1 for a set of viewing directions: equal shares of the cosine-weighted hemisphere,
// then the extremes.
struct SlabTable {
    static constexpr int shares = 8, extremes = 3, turns = 3;
    struct Row {
        double angle_deg; // to the ply's normal
        glm::dvec3 albedo;
    };
    Row rows[(shares + extremes) * turns];
    glm::dvec3 mean{0}; // over the shares
};
SlabTable slab_table(const YarnSpec& spec);

// Light that leaves the slab after two and more scatterings at albedo 1, mean over directions: x reflected, y
// transmitted (math.md 9.2); and the probability of one more scattering after each.
glm::vec2 rescattered_share(float thickness);
float rescattering_probability(float thickness);

// The yarn as the BSDF sees it. What the fabric leaves open follows from the slab: diffuse terms from its own multiple
// scattering (math.md 4.2, 9.2), at most what most_sent_out leaves room for: they are means over directions and would
// exceed it at grazing angles in the whitest yarns.
//   tint  of the draft's colour, [0, 1];  slab  slab_table of the spec
cloth::f32::ClothYarn shade_yarn(const YarnSpec& spec, glm::vec3 tint, const SlabTable& slab);

// Two yarns that lie over each other, as one yarn seen from the side of the upper one: the mathematics are in
// docs/model.md, "Two yarns over each other".
cloth::f32::ClothYarn stack_yarns(const cloth::f32::ClothYarn& upper, const SlabTable& upper_slab,
                                  const cloth::f32::ClothYarn& lower, const SlabTable& lower_slab);

// The largest share that a point of the yarn sends out of what it receives, over directions and channels; at most 1 if
// energy is kept. Light between the fibres counts.
struct YarnEnergy {
    double most = 0;                               // R1 + T1 + U + diffuse
    double angle_deg = 0;                          // of the viewing direction where that is
    int channel = 0;                               // 0 red, 1 green, 2 blue
    double slab = 0, diffuse = 0, unscattered = 0; // its parts
};
YarnEnergy most_sent_out(const cloth::f32::ClothYarn& yarn, const SlabTable& slab);

// Every ingredient of the model as we recommend it: the preset "ours".
inline constexpr cloth::f32::ClothSettings full_model{cloth::f32::cloth_bsdf_meso,
                                                      cloth::f32::cloth_weight_relief,
                                                      cloth::f32::cloth_visibility_horizon8,
                                                      cloth::f32::cloth_slab_ply,
                                                      true,
                                                      true,
                                                      true};

// One random estimate of what the cloth sends towards o under a uniform sky of radiance 1, by the shared functions.
struct SkySample {
    cloth::f32::ClothSelection selection; // the point that was seen; `passes`: the sky behind, and no more
    glm::vec3 front{0}, back{0};          // from the sky on the viewer's side and from that behind, scattered
};
//   o  local, unit, o.z > 0; side, footprint, settings as cloth_select takes them
SkySample sample_sky(const cloth::f32::ClothMaps& maps, int side, const cloth::f32::ClothFootprint& footprint,
                     glm::vec3 o, const cloth::f32::ClothSettings& settings, cloth::f32::ClothRandom random);

// Effective albedo of the cloth seen at one angle, mean over the repeat and over the azimuth: INT F di, math.md 6.6.
struct ClothAlbedo {
    glm::dvec3 reflectance{0}, transmittance{0}; // `straight` is part of the second
    double straight = 0;                         // crosses gaps, or yarns between their fibres
    double standard_error = 0;                   // of reflectance + transmittance, the channel where it is largest
};
//   side  0 front, 1 back; angle to the normal [0, 90); samples: multiples of 256; every run gives the same numbers
ClothAlbedo cloth_albedo(const PackedFabric& fabric, int side, double angle_deg, int samples = 1 << 16,
                         const cloth::f32::ClothSettings& settings = full_model);

} // namespace selvedge
