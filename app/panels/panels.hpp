// app/panels/panels.hpp: the panels of the window. They draw and edit, never render: what they changed comes back, and
// window.cpp acts on it. Included by window.cpp; all need a current ImGui frame.
#pragma once

#include <string>

#include <glm/glm.hpp>

#include "reference/scene.hpp"

namespace selvedge
{

// What an edit asks for, from cheap to dear.
struct Edits {
    bool view = false;     // exposure and such: show again
    bool settings = false; // BSDF, mode, samples a frame, paths
    bool lights = false;
    bool yarns = false;    // of `fabric`: shade_yarns() is enough
    bool geometry = false; // of `fabric`: bake
    std::size_t fabric = 0;
};

// One section for each fabric: every row of bake/params.hpp, colours, pattern.
void draw_fabric_panel(Scene& scene, Edits& edits);

struct LightPanel {
    float turn_degrees = 0; // of all lights at infinity, against the scene file
};
// turned  gets the angle by which to turn the lights now [rad]
void draw_light_panel(LightPanel& panel, Scene& scene, Edits& edits, float& turned);

struct ViewPanel {
    cloth::f32::ClothSettings settings{};
    bool stacked = true; // ModelSpec::stacked
    int footprint_samples = 1;
    bool paths = false;                           // light that bounces, too
    int max_depth = cloth::f32::cloth_path_depth; // surfaces along a path
    int divisor = 1;                              // window pixels along a side of one picture pixel
    bool coarse_while_moving = true;
    bool denoise = true;     // what is shown and saved
    int sample_limit = 4096; // then the window rests
    bool paused = false;
};
struct ViewStatus {
    std::uint32_t frames = 0;
    double milliseconds = 0;
    double done = 0; // share of the picture that has its error
    glm::ivec2 resolution{0};
    std::string renderer, message;
};
void draw_view_panel(ViewPanel& panel, const ViewStatus& status, float& exposure, Edits& edits);

// A line in the middle of the window.
void draw_notice(const char* text);
void draw_help_panel(bool& open);

} // namespace selvedge
