// bake/params.hpp: one row for each number an artist sets on a yarn. The fabric reader, sliders and docs read the rows.
#pragma once

#include "fabric.hpp"

namespace selvedge
{

struct YarnParam {
    const char* key; // in a fabric's "warp" and "weft"; -D warp.KEY=value
    float YarnSpec::*member;
    float low, high;
    bool geometry; // a change asks for a bake; else shade_yarns() is enough
    const char* unit;
    const char* help;
};

inline constexpr YarnParam yarn_params[] = {
    {"spacing", &YarnSpec::spacing_m, 2e-5f, 0.05f, true, "m", "between the axes of neighbouring yarns"},
    {"width", &YarnSpec::width_m, 1e-5f, 0.05f, true, "m", "across the yarn, seen from above"},
    {"aspect", &YarnSpec::aspect, 0.1f, 2.0f, true, "1",
     "height over width of the section: 0.3 flat filament, 0.7 spun"},
    {"ply_twist", &YarnSpec::ply_twist_deg, -60.0f, 60.0f, true, "deg", "plies to yarn axis, Z positive, S negative"},
    {"fibre_twist", &YarnSpec::fibre_twist_deg, -60.0f, 60.0f, false, "deg", "fibres to ply, Z positive"},
    {"roughness", &YarnSpec::roughness, 0.01f, 1.0f, false, "1", "of the reflection: 0.04 silk, 0.2 cotton, 1 felt"},
    {"thickness", &YarnSpec::thickness, 0.02f, 20.0f, false, "1", "optical: 0.3 lets much light through, 4 hardly any"},
    {"diffuse_mix", &YarnSpec::diffuse_mix, 0.0f, 1.0f, false, "1",
     "1: diffuse about the ply's normal, 0: about the cloth's"},
};

inline constexpr int ply_limit = 12; // plies in a yarn

struct Section {
    YarnSection section;
    const char* name;
};
inline constexpr Section yarn_sections[] = {{YarnSection::ellipse, "ellipse"}, {YarnSection::racetrack, "racetrack"}};

// What yarns are made of, for widths from their tex. Densities: Morton & Hearle, "Physical Properties of Textile
// Fibres", table 5.1, at 65 % relative humidity. Packing: share of a ply's section that is fibre; 0.6 is Peirce's
// 1.1 cm^3/g of spun cotton (Journal of the Textile Institute 28, 1937), wool is loftier, filaments lie closer
// (Hearle, Grosberg & Backer, "Structural Mechanics of Fibers, Yarns, and Fabrics", 1969: 0.5 to 0.8).
struct Fibre {
    const char* name;
    float density_kg_m3, packing;
};
inline constexpr Fibre fibres[] = {
    {"cotton", 1520, 0.60f},  {"flax", 1500, 0.60f},      {"wool", 1310, 0.50f},  {"silk", 1340, 0.70f},
    {"viscose", 1490, 0.65f}, {"polyester", 1390, 0.70f}, {"nylon", 1140, 0.70f},
};

} // namespace selvedge
