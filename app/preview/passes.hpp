// app/preview/passes.hpp: the programs of a frame and how each is drawn. Included by preview.hpp.
#pragma once

#include <cstddef>
#include <string>
#include <vector>

#include <glm/glm.hpp>

#include "gl.hpp"
#include "needs.hpp"
#include "scene_buffers.hpp"
#include "shader_source.hpp"
#include "targets.hpp"

namespace selvedge
{

namespace block
{
using namespace glm;
#include "glsl/blocks.h"
static_assert(offsetof(Frame, camera_position) == 0 && offsetof(Frame, camera_forward) == 16);
static_assert(offsetof(Frame, camera_right) == 32 && offsetof(Frame, camera_up) == 48);
static_assert(offsetof(Frame, lens) == 64 && offsetof(Frame, film) == 80 && offsetof(Frame, random) == 96);
static_assert(offsetof(Frame, depth) == 112 && offsetof(Frame, lights) == 128);
static_assert(offsetof(Frame, model) == 144 && offsetof(Frame, ingredients) == 160 && sizeof(Frame) == 176);
} // namespace block

class Passes
{
  public:
    explicit Passes(const GlInfo& info);

    // From now on the programs have what the scene needs; they are compiled when they are first drawn with.
    void choose(const Needs& needs);
    void set_frame(const block::Frame& frame);

    void visibility(Targets& targets, const SceneBuffers& buffers);
    void shade(Targets& targets, const SceneBuffers& buffers);
    // Folds a complete block into the mean and clears its sum. blocks counts it.
    void merge(Targets& targets, std::uint32_t block_length, std::uint32_t blocks);
    void present(const Targets& targets, glm::ivec2 corner, glm::ivec2 size, float block_weight, float mean_weight,
                 float exposure);

    bool rebuild_if_changed(); // true: at least one program is another one now
    // Why the programs that were chosen are not in use; empty where all is well.
    std::string complaint() const;
    const std::vector<std::string>& features() const { return defines; }

  private:
    void draw_screen();

    bool clip_control;
    std::vector<std::string> defines, gauze_defines; // of shading, and of the visibility of what rays may pass through
    ProgramVariants opaque_visibility{"visibility.vert", "visibility.frag"};
    ProgramVariants gauze_visibility{"visibility.vert", "visibility.frag"};
    ProgramVariants shading{"screen.vert", "shade.frag"}, merging{"screen.vert", "merge.frag"};
    ProgramVariants presenting{"screen.vert", "present.frag"};
    GlName frame_block, empty_array;
};

} // namespace selvedge
