// app/preview/preview.hpp: the preview: a scene in, an accumulating picture out. Needs a current GL context with loaded
// functions (gl.hpp) and nothing of a window.
#pragma once

#include <chrono>
#include <cstdint>
#include <map>
#include <set>
#include <string>
#include <vector>

#include "gl.hpp"
#include "passes.hpp"
#include "reference/adaptive.hpp"
#include "reference/scene.hpp"
#include "scene_buffers.hpp"
#include "targets.hpp"

namespace selvedge
{

// How the triangles that pixels see are found. Automatic: by rays where software GL has fewer than four pixels for a
// triangle, if there is a BVH anyway.
enum class Finding { automatic, raster, rays };

// What shades pixels. Automatic: compute shaders where a card has them, since cards for computing (H100) draw fragments
// with a few of their processors; software GL works on either in the same way.
enum class Shading { automatic, fragment, compute };

struct PreviewOptions {
    std::uint32_t seed = 0;
    int footprint_samples = 1;  // samples of each pixel in a frame, of one ray, [1, 64]
    int max_depth = 1;          // surfaces that scatter along a path, 1: direct light alone
    bool reproject = true;      // while the view moves, what earlier views showed is shown at its new place
    std::set<std::string> kept; // parts of skip_names() that are done whether the scene needs them or not
    std::uint32_t planned = 0;  // frames that will be drawn, 0 when nobody knows: decides the length of a block
    glm::ivec2 planned_size{0}; // resolution that matters for what is automatic, 0: the present one
    Finding finding = Finding::automatic;
    Shading shading = Shading::automatic;
    bool knows_spread = false; // of frames: noise is known after a few, and present() can take it out
    bool waits = true;         // for drivers that compile aside: else draw_frame() draws nothing until they have done
    double target_error = 0;   // above 0: tiles end by themselves, and are drawn no more (reference/adaptive.hpp)
};

// The accumulated picture on the CPU: row 0 is the top row.
struct PreviewImage {
    glm::ivec2 size{0};
    std::uint32_t frames = 0;           // drawn, where none was skipped
    std::uint32_t blocks = 0;           // complete blocks
    std::vector<std::uint32_t> samples; // of each pixel
    std::vector<glm::vec4> mean;        // radiance and coverage, mean of all samples (of tiles: reference/adaptive.hpp)
    std::vector<glm::vec4> variance;    // of the pixel's mean, from the spread of the blocks; 0 below two blocks
    // Likewise, from the spread of frames: more than it is, since frames of a block are stratified. 0 below two frames;
    // empty where PreviewOptions::knows_spread is not set.
    std::vector<glm::vec4> frame_variance;
};

// Everything that changes the picture restarts the accumulation; nothing else does. What is shown while a new view has
// few samples may hold what earlier views knew of the same places (glsl/carry.frag); what is accumulated, and so the
// picture that read() returns and that is shown after carry_frames, never does.
class Preview
{
  public:
    static constexpr std::uint32_t carry_frames = 32; // after as many, nothing of earlier views is shown

    // Uploads the scene. The scene must outlive the preview. Shaders are compiled when the first frame wants them.
    //   throws  std::runtime_error (limits of the driver)
    Preview(const Scene& scene, const GlInfo& info, glm::ivec2 resolution, const PreviewOptions& options);

    void set_camera(const CameraSpec& camera);
    void set_options(const PreviewOptions& options);
    void resize(glm::ivec2 resolution);
    // After the scene's lights, its yarns, or anything else in it have been edited.
    void lights_changed();
    void yarns_changed();
    void scene_changed();
    void model_changed(); // scene.model.settings
    void restart();

    // Tells, while the first block is unfinished, how many frames there will be: sets the length of blocks.
    void plan(std::uint32_t planned);

    // Adds one sample to every pixel, but for tiles that have reached the target error. Where a shader does not
    // compile, though one did before (reload_shaders() tells), or has not been compiled yet (compiling()), nothing is
    // drawn, and the last good picture stays on show.
    //   return  whether it was drawn
    //   throws  InputError: a shader that never compiled
    bool draw_frame();
    bool compiling() { return passes.compiling(); }
    std::uint32_t frames() const { return stale ? 0 : frame_count; }
    std::uint32_t block_length() const { return length; }
    bool finished() const { return !stale && !tiles.empty() && all_done(tiles); } // every tile has the target error
    std::size_t tile_count() const { return tiles.size(); }                       // 0 where there is no target
    std::size_t tiles_done() const;
    std::uint64_t samples() const; // of all pixels together
    glm::ivec2 resolution() const { return targets.size(); }

    // The accumulated picture through the display transform into a rectangle of the bound framebuffer (GL window
    // coordinates: from the lower left), stretched without filtering.
    //   denoised  without its noise (reference/denoise.hpp), by a share of the samples that is never far from all;
    //   needs
    //             knows_spread. Where too little is known, and where it is finished, the picture is shown as it is.
    void present(glm::ivec2 corner, glm::ivec2 size, float exposure, bool denoised = false);
    PreviewImage read() const;

    // Recompiles shaders that were saved; a broken one leaves the last good program in place.
    //   return  the compiler's complaint, empty where all is well
    std::string reload_shaders();

    std::vector<std::string> features() const; // what was compiled in
    std::vector<std::string> pass_names() const;
    // Parts that the scene did not need: name -> left out.
    const std::map<std::string, bool>& skipped() const { return needs.skipped; }
    std::size_t buffer_bytes() const { return buffers.bytes(); }

  private:
    // What the scene needs now; uploads and compiles nothing but what rays walk, where that has changed.
    void find_needs();
    bool finds_by_rays() const;
    bool computes() const; // throws std::runtime_error: asked for, and the driver cannot
    void remember();
    void begin_again(); // with the next frame accumulates from nothing; until then the last picture is shown
    ShownWeights shown_weights() const;
    void update_near_plane();
    void restart_tiles();
    void judge(); // after as many blocks of either half: which tiles end
    std::uint32_t blocks_of(int half) const;
    std::uint64_t samples_of(const TileState& tile) const
    {
        return tile.done() ? tile.samples : frames();
    } // frames of it
    PreviewImage read_tiled(PreviewImage image) const;
    void add_frame_variance(PreviewImage& image) const;
    void refresh_denoised();

    const Scene& scene;
    GlInfo info;
    PreviewOptions options;
    CameraSpec camera;
    BlockingShape shape;
    Needs needs;
    SceneBuffers buffers;
    Targets targets;
    Passes passes;
    float near_plane = 0.01f;
    cloth::f32::ClothCamera past{};             // of the remembered view
    bool has_past = false, has_carried = false; // a view is remembered; its picture is found again in the present one
    std::uint32_t view_count = 0;               // that were looked at: each has random numbers of its own
    bool stale = true;                          // what is accumulated belongs to something that has changed
    std::uint32_t frame_count = 0, block_count = 0, length = 1;
    std::uint32_t denoised_frames = 0; // that the filtered picture on show was made from; 0: there is none
    double denoise_seconds = 0;        // that making it took
    std::chrono::steady_clock::time_point denoised_at{};
    std::vector<TileState> tiles; // row by row; empty where there is no target error
    double pilot[2] = {0, 0};     // of judge_tiles()
};

} // namespace selvedge
