// selvedge-drive-preview SCENE.json WIDTH,HEIGHT: the preview moved and edited by commands on stdin, one a line, as the
// window does it. For the tests and benchmarks only.
// - camera PX PY PZ TX TY TZ: look from P to T
// - frames N: draw N frames; plan N: how many there will be of a view
// - accumulated OUT.exr: the accumulated picture, as --headless writes it
// - shown OUT.exr: what is on show, through the display transform at exposure 0; denoised OUT.exr: filtered
// - knows-spread 0|1: of frames, which the filter needs
// - light INDEX R G B: radiance of a light; yarn INDEX R G B: albedo of all yarn types of a fabric
// - model KEY VALUE: bsdf, weight, visibility, ...: numbers of ClothSettings
// - resize WIDTH HEIGHT: either may be 0
// - reproject 0|1; max-depth N: surfaces along a path; keep NAME: do that part's work, needed or not
// - target SEED ERROR: starts anew; tiles end by themselves at that error
// - now: waits for the driver and prints seconds since the last `now`
#include <chrono>
#include <cstdio>
#include <iostream>
#include <sstream>

#include "app/preview/context.hpp"
#include "app/preview/preview.hpp"
#include "app/preview/result.hpp"
#include "bake/error.hpp"
#include "bake/program.hpp"

namespace
{

using namespace selvedge;
using Clock = std::chrono::steady_clock;

// What present() draws, read back.
void write_shown(Preview& preview, const std::string& path, bool denoised)
{
    const glm::ivec2 size = preview.resolution();
    GlName texture(GlName::Kind::texture), framebuffer(GlName::Kind::framebuffer);
    gl.BindTexture(GL_TEXTURE_2D, *texture);
    gl.TexImage2D(GL_TEXTURE_2D, 0, GL_RGBA32F, size.x, size.y, 0, GL_RGBA, GL_FLOAT, nullptr);
    gl.BindFramebuffer(GL_FRAMEBUFFER, *framebuffer);
    gl.FramebufferTexture2D(GL_FRAMEBUFFER, GL_COLOR_ATTACHMENT0, GL_TEXTURE_2D, *texture, 0);
    preview.present({0, 0}, size, 0, denoised);
    Image image(size.x, size.y, {"R", "G", "B", "A"});
    gl.BindFramebuffer(GL_FRAMEBUFFER, *framebuffer);
    gl.ReadBuffer(GL_COLOR_ATTACHMENT0);
    std::vector<float> rows(image.pixels.size());
    gl.ReadPixels(0, 0, size.x, size.y, GL_RGBA, GL_FLOAT, rows.data());
    check_gl("shown");
    for (int y = 0; y < size.y; ++y) // the window's rows count from below
        std::copy_n(rows.data() + 4 * std::ptrdiff_t(size.x) * (size.y - 1 - y), 4 * size.x, image.at(0, y));
    write_exr(path, image);
}

void set_model(cloth::f32::ClothSettings& model, const std::string& key, int value)
{
    if (key == "bsdf")
        model.bsdf = value;
    else if (key == "weight")
        model.weight = value;
    else if (key == "visibility")
        model.visibility = value;
    else if (key == "unscattered")
        model.unscattered = value != 0;
    else if (key == "interreflection")
        model.interreflection = value != 0;
    else
        throw UsageError("model: '%s' is unknown", key.c_str());
}

void drive(Scene& scene, Preview& preview, PreviewOptions& options)
{
    Clock::time_point last = Clock::now();
    for (std::string line; std::getline(std::cin, line);) {
        std::istringstream words(line);
        std::string verb, text;
        glm::vec3 colour(0);
        glm::ivec2 size(0);
        std::size_t index = 0;
        int count = 0;
        words >> verb;
        if (verb == "camera") {
            CameraSpec camera = scene.camera;
            glm::vec3 &p = camera.position, &t = camera.target;
            words >> p.x >> p.y >> p.z >> t.x >> t.y >> t.z;
            preview.set_camera(camera);
        } else if (verb == "frames") {
            words >> count;
            for (int k = 0; k < count; ++k) preview.draw_frame();
        } else if (verb == "plan") {
            words >> count;
            preview.plan(static_cast<std::uint32_t>(count));
        } else if (verb == "accumulated") {
            words >> text;
            write_result(text, result_of(preview.read()), 0, {});
        } else if (verb == "shown" || verb == "denoised") {
            words >> text;
            write_shown(preview, text, verb == "denoised");
        } else if (verb == "light") {
            words >> index >> colour.x >> colour.y >> colour.z;
            scene.lights.at(index).radiance = colour;
            preview.lights_changed();
        } else if (verb == "yarn") {
            words >> index >> colour.x >> colour.y >> colour.z;
            for (cloth::f32::ClothYarn& yarn : scene.fabrics.at(index).yarns) yarn.albedo_r = colour;
            preview.yarns_changed();
        } else if (verb == "model") {
            words >> text >> count;
            set_model(scene.model.settings, text, count);
            preview.model_changed();
        } else if (verb == "resize") {
            words >> size.x >> size.y;
            preview.resize(size);
        } else if (verb == "reproject") {
            words >> options.reproject;
            preview.set_options(options);
        } else if (verb == "knows-spread") {
            words >> options.knows_spread;
            preview.set_options(options);
        } else if (verb == "max-depth") {
            words >> options.max_depth;
            preview.set_options(options);
        } else if (verb == "keep") {
            words >> text;
            options.kept.insert(text);
            preview.set_options(options);
        } else if (verb == "target") {
            words >> options.seed >> options.target_error;
            preview.set_options(options);
        } else if (verb == "now") {
            gl.Finish();
            const Clock::time_point now = Clock::now();
            std::printf("%.9g\n", std::chrono::duration<double>(now - last).count());
            std::fflush(stdout);
            last = now;
        } else {
            throw UsageError("'%s' is no command", verb.c_str());
        }
        if (words.fail()) throw UsageError("'%s' lacks a value", line.c_str());
        check_gl(line.c_str());
    }
}

} // namespace

int main(int argc, char** argv)
{
    return run_program("selvedge-drive-preview", [&] {
        glm::ivec2 size{0};
        if (argc != 3 || std::sscanf(argv[2], "%d,%d", &size.x, &size.y) != 2)
            throw UsageError("expected SCENE.json WIDTH,HEIGHT");
        Scene scene = load_scene(argv[1]);
        const auto context = Context::create(Backend::automatic);
        PreviewOptions options;
        Preview preview(scene, context->info, size, options);
        drive(scene, preview, options);
        return 0;
    });
}
