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

} // namespace selvedge
