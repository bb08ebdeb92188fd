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
static_assert(offsetof(Frame, model) == 144 && offsetof(Frame, ingredients) == 160);
static_assert(offsetof(Frame, past_position) == 176 && offsetof(Frame, past_forward) == 192);
static_assert(offsetof(Frame, past_right) == 208 && offsetof(Frame, past_up) == 224 && sizeof(Frame) == 240);
} // namespace block

// What of the accumulated picture is shown: glsl/shown.h.
struct ShownWeights {
    float block = 0, mean = 0, odd_mean = 0, samples = 0, carried = 0;
};

class Passes
{
  public:
    explicit Passes(const GlInfo& info);

    // From now on the programs have what the scene needs; they are compiled when they are first drawn with.
    //   tiles    they end by themselves: reference/adaptive.hpp
    //   squares  the spread of frames is asked for
    //   computes  pixels are dealt out to compute shaders, where the rasteriser finds nothing
    void choose(const Needs& needs, bool tiles, bool squares, bool computes);
    // Compiles what a frame is drawn with, where that has not been done.
    //   waits   for drivers that compile aside
    //   return  false: nothing may be drawn, because they have not done (compiling()), or because something that was
    //           chosen does not compile, though what was chosen before did (complaint() says why)
    //   throws  InputError, std::runtime_error where nothing ever compiled
    bool prepare(const SceneBuffers& buffers, bool waits);
    bool compiling();
    void set_frame(const block::Frame& frame);
    // From now on only these tiles of a picture of that size are drawn (row by row, reference/adaptive.hpp); one at
    // least; only where tiles end by themselves.
    void set_tiles(glm::ivec2 size, const std::vector<bool>& drawn);
    // From now on only these blocks are shaded (row by row, block_nodes.hpp): all others show what is behind
    // everything. Only where rays find what pixels see.
    void set_blocks(glm::ivec2 size, const std::vector<bool>& seeing);

    void visibility(Targets& targets, const SceneBuffers& buffers); // by the rasteriser
    void shade(Targets& targets, const SceneBuffers& buffers);
    // Folds a complete block into its half's mean and clears its sum. blocks counts it.
    void merge(Targets& targets, int half, std::uint32_t block_length, std::uint32_t blocks);
    // Finds what each half says of the tiles' noise: Targets::read_tiles().
    void judge(Targets& targets);
    // Keeps what a half has of the tiles that are drawn, after `blocks` blocks of it.
    void keep(Targets& targets, int half, std::uint32_t blocks);
    // Puts what is shown, and where it is, aside for the next view; all by the frame that was drawn last.
    void remember(Targets& targets, const SceneBuffers& buffers, const ShownWeights& weights);
    // Finds what was put aside in the first frame of a view; after it is shaded.
    void carry(Targets& targets, const SceneBuffers& buffers);
    //   denoised  what Targets::show() has taken, in place of the accumulated picture
    void present(const Targets& targets, glm::ivec2 corner, glm::ivec2 size, const ShownWeights& weights,
                 float exposure, bool denoised);

    bool rebuild_if_changed(); // true: at least one program is another one now
    // Why the programs that were chosen are not in use; empty where all is well.
    std::string complaint();
    const std::vector<std::string>& features() const { return defines; }

  private:
    // Of the vertices in `corners`.
    struct Run {
        GLint first = 0;
        GLsizei count = 0;
    };

    void lay_out(glm::ivec2 size);
    void draw_screen(); // all of the viewport
    void draw_tiles();  // those of set_tiles(), all of it where nobody has set any
    void draw_run(const ShaderProgram& program, Run run);
    void dispatch(const ShaderProgram& program, Targets& targets); // likewise, for a compute shader
    // Of a pass that is a compute shader where there are any.
    std::vector<std::string> dispatch_defines(std::vector<std::string> own) const;
    std::vector<std::string> screen_defines() const;
    static void set_weights(const ShaderProgram& program, const ShownWeights& weights);
    std::vector<std::string> view_defines() const;
    std::vector<std::string> gauze_defines() const;
    std::vector<ProgramVariants*> all();

    const GlInfo info;
    std::vector<std::string> defines;       // of shading
    std::vector<std::string> light_defines; // of what is behind everything
    std::vector<std::string> model_defines; // the model's alone
    ProgramVariants opaque_visibility{{"visibility.vert", "visibility.frag"}};
    ProgramVariants gauze_visibility{{"visibility.vert", "visibility.frag"}};
    ProgramVariants shading{{"screen.vert", "shade.frag"}}, computed_shading{{"shade.comp"}};
    ProgramVariants backdrop{{"screen.vert", "background.frag"}};
    ProgramVariants merging{{"screen.vert", "merge.frag"}};
    ProgramVariants presenting{{"screen.vert", "present.frag"}};
    ProgramVariants remembering{{"screen.vert", "remember.frag"}}, carrying{{"screen.vert", "carry.frag"}};
    ProgramVariants uncovering{{"screen.vert", "uncover.frag"}}, judging{{"screen.vert", "judge.frag"}};
    ProgramVariants keeping{{"screen.vert", "keep.frag"}};
    GlName frame_block, screen_array;
    bool camera_rays = false;                     // in place of the rasteriser
    bool computes = false;                        // what needs no rasteriser is done by compute shaders
    bool seen_alone = false;                      // what sees nothing is not shaded
    bool tiled = false;                           // tiles end by themselves
    std::vector<bool> drawn_tiles, seeing_blocks; // empty: all of them
    static constexpr Run empty_run{3, 3};         // of no area
    GlName corners;                               // vertices of the whole screen, of empty_run, then of
    Run tile_run, seeing_run, blind_run;          //   tiles that are drawn, and what of them is shaded and is not
    bool backdrop_drawn = false;                  // the driver has compiled it, too
    BufferTexture tile_flags;                     // which are drawn, for compute shaders
};

} // namespace selvedge
