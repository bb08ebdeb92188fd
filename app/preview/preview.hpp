// app/preview/preview.hpp: the preview: a scene in, an accumulating picture out. Needs a current GL context with loaded
// functions (gl.hpp) and nothing of a window.
#pragma once

#include <cstdint>
#include <map>
#include <string>
#include <vector>

#include "gl.hpp"
#include "passes.hpp"
#include "reference/scene.hpp"
#include "scene_buffers.hpp"
#include "targets.hpp"

namespace selvedge
{

struct PreviewOptions {
    std::uint32_t seed = 0;
    int footprint_samples = 1; // shaded points of each pixel in a frame, [1, 64]
    std::uint32_t planned = 0; // frames that will be drawn, 0 when nobody knows: decides the length of a block
};

// The accumulated picture on the CPU: row 0 is the top row.
struct PreviewImage {
    glm::ivec2 size{0};
    std::uint32_t frames = 0;        // samples of every pixel
    std::uint32_t blocks = 0;        // complete blocks
    std::vector<glm::vec4> mean;     // radiance and coverage, mean of all samples
    std::vector<glm::vec4> variance; // of the pixel's mean, from the spread of the blocks; 0 below two blocks
};

// Everything that changes the picture restarts the accumulation; nothing else does.
class Preview
{
  public:
    // Uploads the scene, compiles the shaders that it needs. The scene must outlive the preview.
    //   throws  InputError (shaders), std::runtime_error (limits of the driver)
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

    void draw_frame(); // adds one sample to every pixel
    std::uint32_t frames() const { return frame_count; }
    std::uint32_t block_length() const { return length; }
    glm::ivec2 resolution() const { return targets.size(); }

    // The accumulated picture through the display transform into a rectangle of the bound framebuffer (GL window
    // coordinates: from the lower left), stretched without filtering.
    void present(glm::ivec2 corner, glm::ivec2 size, float exposure);
    PreviewImage read() const;

    // Recompiles shaders that were saved; a broken one leaves the last good program in place.
    //   return  the compiler's complaint, empty where all is well
    std::string reload_shaders();

    std::vector<std::string> features() const; // what was compiled in
    std::vector<std::string> pass_names() const;
    std::map<std::string, bool> skipped() const; // parts that the scene did not need: name -> left out
    std::size_t buffer_bytes() const { return buffers.bytes(); }

  private:
    void choose_programs();
    void update_near_plane();

    const Scene& scene;
    GlInfo info;
    PreviewOptions options;
    CameraSpec camera;
    SceneBuffers buffers;
    Targets targets;
    Passes passes;
    float near_plane = 0.01f;
    std::uint32_t frame_count = 0, block_count = 0, length = 1;
};

} // namespace selvedge
