// app/window.cpp: the window: events, panels, frames while there is something to show, rest when there is not.
#include "app/window.hpp"

#include <algorithm>
#include <chrono>
#include <cstdio>
#include <stdexcept>

#define GLFW_INCLUDE_NONE
#include <GLFW/glfw3.h>
#include <backends/imgui_impl_glfw.h>
#include <backends/imgui_impl_opengl3.h>
#include <imgui.h>

#include "app/options.hpp"
#include "app/panels/panels.hpp"
#include "app/preview/preview.hpp"
#include "app/preview/result.hpp"
#include "app/scene_edit.hpp"
#include "app/viewport.hpp"
#include "bake/error.hpp"
#include "reference/denoise.hpp"

namespace selvedge
{
namespace
{

using Clock = std::chrono::steady_clock;

// relMSE of a picture that a display with 8 bits cannot tell from the true one: noise of half a code value where the
// display transform is steepest for relMSE's weights, in black, 12.92 (slope of sRGB) * sqrt(0.01) = 1.292.
constexpr double display_error = (0.5 / 255 / 1.292) * (0.5 / 255 / 1.292);

double seconds_between(Clock::time_point from, Clock::time_point to)
{
    return std::chrono::duration<double>(to - from).count();
}

class GlfwLibrary
{
  public:
    GlfwLibrary()
    {
        glfwSetErrorCallback([](int, const char* text) { last_error() = text; });
        if (glfwInit() != GLFW_TRUE)
            throw std::runtime_error("no window: " + last_error() + " (without a display use --headless)");
    }
    ~GlfwLibrary() { glfwTerminate(); }
    GlfwLibrary(const GlfwLibrary&) = delete;
    GlfwLibrary& operator=(const GlfwLibrary&) = delete;
    static std::string& last_error()
    {
        static std::string text = "unknown reason";
        return text;
    }
};

GLFWwindow* open_window(glm::ivec2 size, const std::string& title)
{
    struct Wish {
        int major, minor, robustness;
    };
    // A driver that can tell that it has lost the context is asked to; not all take the question.
    for (const auto& [major, minor, robustness] :
         {Wish{4, 5, GLFW_LOSE_CONTEXT_ON_RESET}, Wish{4, 5, GLFW_NO_ROBUSTNESS}, Wish{4, 3, GLFW_NO_ROBUSTNESS},
          Wish{4, 1, GLFW_NO_ROBUSTNESS}}) {
        glfwDefaultWindowHints();
        glfwWindowHint(GLFW_CONTEXT_ROBUSTNESS, robustness);
        glfwWindowHint(GLFW_CONTEXT_VERSION_MAJOR, major);
        glfwWindowHint(GLFW_CONTEXT_VERSION_MINOR, minor);
        glfwWindowHint(GLFW_OPENGL_PROFILE, GLFW_OPENGL_CORE_PROFILE);
#ifdef __APPLE__
        glfwWindowHint(GLFW_OPENGL_FORWARD_COMPAT, GLFW_TRUE);
#endif
        // Everything is drawn to framebuffers of our own; only panels and the finished picture reach the window.
        glfwWindowHint(GLFW_DEPTH_BITS, 0);
        glfwWindowHint(GLFW_STENCIL_BITS, 0);
        if (GLFWwindow* window = glfwCreateWindow(size.x, size.y, title.c_str(), nullptr, nullptr)) return window;
    }
    throw std::runtime_error("no OpenGL 4.5, 4.3 or 4.1 window: " + GlfwLibrary::last_error());
}

// One run of the window. Callbacks of GLFW reach it through the window's user pointer.
class Window
{
  public:
    Window(const LookdevOptions& from, Scene&& loaded)
        : options(from), scene(std::move(loaded)), original(scene.camera), camera(scene.camera),
          exposure(scene.film.exposure)
    {
        handle = open_window(options.resolution.value_or(scene.film.resolution), "Selvedge: " + options.scene);
        glfwSetWindowUserPointer(handle, this);
        glfwMakeContextCurrent(handle);
        info = load_gl([](const char* name) { return glfwGetProcAddress(name); });
        glfwSwapInterval(0); // waiting for the display would only slow convergence down; see run() for the pace
        glfwSetMouseButtonCallback(handle, [](GLFWwindow* w, int, int, int) { self(w).wake(); });
        glfwSetCursorPosCallback(handle, [](GLFWwindow* w, double x, double y) { self(w).pointer_moved(x, y); });
        glfwSetScrollCallback(handle, [](GLFWwindow* w, double, double y) { self(w).wheel_turned(y); });
        glfwSetKeyCallback(handle, [](GLFWwindow* w, int key, int, int action, int mods) {
            if (action != GLFW_RELEASE) self(w).key_pressed(key, mods);
        });
        for (const auto set : {glfwSetFramebufferSizeCallback, glfwSetWindowSizeCallback})
            set(handle, [](GLFWwindow* w, int, int) { self(w).wake(); });
        glfwSetWindowRefreshCallback(handle, [](GLFWwindow* w) { self(w).wake(); });
        // After ours: ImGui calls on to them.
        ImGui::CreateContext();
        ImGui::GetIO().IniFilename = nullptr; // no files where nobody asked for one
        ImGui::StyleColorsDark();
        ImGui_ImplGlfw_InitForOpenGL(handle, true);
        ImGui_ImplOpenGL3_Init("#version 410 core");
        view.settings = scene.model.settings;
        view.stacked = scene.model.stacked;
        view.footprint_samples = options.footprint_samples;
        view.paths = options.paths;
        view.max_depth = options.max_depth;
        status.renderer = info.renderer;
        preview = std::make_unique<Preview>(scene, info, picture_size(), preview_options());
    }

    ~Window()
    {
        preview.reset(); // while its context lives
        ImGui_ImplOpenGL3_Shutdown();
        ImGui_ImplGlfw_Shutdown();
        ImGui::DestroyContext();
        glfwDestroyWindow(handle);
    }
    Window(const Window&) = delete;
    Window& operator=(const Window&) = delete;

    // Until the user closes it, or the driver loses its context.
    //   return  false: lost; the scene with all edits is in take_scene()
    bool run()
    {
        std::uint32_t drawn = 0;
        while (!glfwWindowShouldClose(handle)) {
            const bool sizeless = window_size().x < 1 || window_size().y < 1; // iconified, or drawn to nothing
            const bool rests = sizeless || view.paused || blocked || preview->finished() ||
                               preview->frames() >= static_cast<std::uint32_t>(view.sample_limit);
            if (sizeless || (rests && awake == 0))
                glfwWaitEventsTimeout(1.0); // only to look for saved shaders
            else if (preview->compiling())
                glfwWaitEventsTimeout(0.05);
            else
                glfwPollEvents();
            reload_shaders();
            if (sizeless) continue;
            if (rests && awake == 0 && !dirty) continue;
            const Clock::time_point start = Clock::now();
            dirty = false;
            adapt_size();
            bool drew = false;
            if (!rests) {
                drew = preview->draw_frame();
                blocked = !drew && !preview->compiling();
                drawn += drew ? 1 : 0;
            }
            if (awake > 0) --awake;
            show();
            gl.Finish();
            if (context_lost()) return false;
            if (drew) {
                const double ms = 1e3 * seconds_between(start, Clock::now());
                status.milliseconds = status.milliseconds > 0 ? status.milliseconds * 0.9 + ms * 0.1 : ms;
            }
            if (options.exit_after_frames > 0 && drawn >= options.exit_after_frames) break;
        }
        return true;
    }

    // With the camera where it was moved to.
    Scene take_scene()
    {
        preview.reset();
        scene.camera = camera;
        return std::move(scene);
    }

  private:
    static Window& self(GLFWwindow* window) { return *static_cast<Window*>(glfwGetWindowUserPointer(window)); }

    // ImGui answers an event one or two frames later.
    void wake()
    {
        awake = 3;
        blocked = false;
    }

    glm::ivec2 window_size() const
    {
        glm::ivec2 size{0};
        glfwGetFramebufferSize(handle, &size.x, &size.y);
        return size;
    }

    glm::ivec2 picture_size() const
    {
        const bool moving = view.coarse_while_moving && seconds_between(last_move, Clock::now()) < 0.25;
        return glm::max(window_size() / (view.divisor * (moving ? moving_divisor : 1)), glm::ivec2(1));
    }

    // Follows the window, and keeps the picture moving at 15 frames a second where it can.
    void adapt_size()
    {
        const glm::ivec2 wanted = picture_size();
        if (wanted != preview->resolution()) {
            preview->resize(wanted);
            status.milliseconds = 0;
        }
    }

    PreviewOptions preview_options() const
    {
        PreviewOptions wanted = options.for_preview();
        wanted.footprint_samples = view.footprint_samples;
        wanted.max_depth = view.paths ? view.max_depth : 1;
        wanted.knows_spread = true;
        wanted.waits = false;
        wanted.target_error = options.target_error > 0 ? options.target_error : display_error;
        // Where less than a display can show is asked for, soon; else the longest blocks, whose samples lie best.
        wanted.planned = options.target_error > 0 ? adaptive_planned(0) : 0;
        return wanted;
    }

    // ---- input ---------------------------------------------------------------------------------------------------

    bool pressed(int button) const { return glfwGetMouseButton(handle, button) == GLFW_PRESS; }
    bool held(int left, int right) const
    {
        return glfwGetKey(handle, left) == GLFW_PRESS || glfwGetKey(handle, right) == GLFW_PRESS;
    }

    void moved()
    {
        // Judged before the picture shrinks: later frames are short because it has shrunk.
        if (seconds_between(last_move, Clock::now()) > 0.25)
            moving_divisor = status.milliseconds > 264 ? 4 : status.milliseconds > 66 ? 2 : 1;
        last_move = Clock::now();
    }

    void move_camera(const CameraSpec& wanted)
    {
        moved();
        camera = wanted;
        preview->set_camera(camera);
    }

    void pointer_moved(double x, double y)
    {
        wake();
        const glm::dvec2 at(x, y), step = at - pointer;
        pointer = at;
        if (ImGui::GetIO().WantCaptureMouse || preview == nullptr) return;
        glm::ivec2 size{1};
        glfwGetWindowSize(handle, &size.x, &size.y);
        const glm::vec2 share = glm::vec2(step) / static_cast<float>(std::max(size.y, 1));
        const bool shift = held(GLFW_KEY_LEFT_SHIFT, GLFW_KEY_RIGHT_SHIFT);
        const bool control = held(GLFW_KEY_LEFT_CONTROL, GLFW_KEY_RIGHT_CONTROL);
        const bool left = pressed(GLFW_MOUSE_BUTTON_LEFT), right = pressed(GLFW_MOUSE_BUTTON_RIGHT);
        if ((left && control) || (right && shift))
            turn(share.x * 3);
        else if (pressed(GLFW_MOUSE_BUTTON_MIDDLE) || (left && shift))
            move_camera(panned(camera, {-share.x, share.y}));
        else if (left)
            move_camera(orbited(camera, -share.x * 4, share.y * 4));
        else if (right)
            move_camera(zoomed(camera, std::exp(share.y * 4)));
    }

    void wheel_turned(double steps)
    {
        wake();
        if (!ImGui::GetIO().WantCaptureMouse) move_camera(zoomed(camera, std::pow(0.9f, static_cast<float>(steps))));
    }

    void key_pressed(int key, int mods)
    {
        wake();
        if (ImGui::GetIO().WantTextInput) return;
        const glm::ivec2 size = glm::max(window_size(), glm::ivec2(1));
        switch (key) {
        case GLFW_KEY_F:
            move_camera(fitted(camera, bounds_of(scene), static_cast<float>(size.x) / static_cast<float>(size.y)));
            break;
        case GLFW_KEY_R:
            move_camera(original);
            break;
        case GLFW_KEY_E:
            exposure += (mods & GLFW_MOD_SHIFT) != 0 ? -0.5f : 0.5f;
            break;
        case GLFW_KEY_SPACE:
            view.paused = !view.paused;
            break;
        case GLFW_KEY_P:
            panels_open = !panels_open;
            break;
        case GLFW_KEY_H:
        case GLFW_KEY_SLASH:
            help_open = !help_open;
            break;
        case GLFW_KEY_F12:
            save_picture();
            break;
        default:
            break;
        }
    }

    void turn(float angle)
    {
        moved();
        light_panel.turn_degrees = std::remainder(light_panel.turn_degrees + glm::degrees(angle), 360.0f);
        turn_lights(scene, angle);
        preview->lights_changed();
    }

    void save_picture()
    {
        try {
            ImageMetadata metadata = options.provenance;
            metadata["selvedge:samples"] = std::to_string(preview->frames());
            RenderResult result = result_of(preview->read());
            if (view.denoise && denoise(result)) metadata["selvedge:denoised"] = denoised_by;
            write_result(options.screenshot, result, exposure, metadata);
            status.message = "saved " + options.screenshot;
        } catch (const std::exception& error) {
            status.message = error.what();
        }
    }

    void reload_shaders()
    {
        const Clock::time_point now = Clock::now();
        if (seconds_between(last_look, now) < 0.5) return;
        last_look = now;
        const std::string complaint = preview->reload_shaders();
        if (complaint == shader_complaint) return;
        shader_complaint = complaint;
        status.message = complaint;
        if (!complaint.empty()) std::fprintf(stderr, "selvedge-lookdev: %s\n", complaint.c_str());
        wake();
    }

    // ---- a frame of the window -----------------------------------------------------------------------------------

    void show()
    {
        const glm::ivec2 size = window_size();
        gl.BindFramebuffer(GL_FRAMEBUFFER, 0);
        preview->present({0, 0}, size, exposure, view.denoise);

        ImGui_ImplOpenGL3_NewFrame();
        ImGui_ImplGlfw_NewFrame();
        ImGui::NewFrame();
        Edits edits;
        float turned = 0;
        if (panels_open) {
            const ImGuiViewport* area = ImGui::GetMainViewport();
            ImGui::SetNextWindowPos({area->WorkPos.x + 8, area->WorkPos.y + 8}, ImGuiCond_FirstUseEver);
            ImGui::SetNextWindowSize({320, std::max(area->WorkSize.y - 16, 64.0f)}, ImGuiCond_FirstUseEver);
            ImGui::SetNextWindowBgAlpha(0.8f);
            if (ImGui::Begin("Selvedge")) {
                ImGui::PushItemWidth(-110);
                status.frames = preview->frames();
                status.done = static_cast<double>(preview->tiles_done()) / static_cast<double>(preview->tile_count());
                status.resolution = preview->resolution();
                draw_view_panel(view, status, exposure, edits);
                draw_light_panel(light_panel, scene, edits, turned);
                draw_fabric_panel(scene, edits);
                ImGui::PopItemWidth();
            }
            ImGui::End();
        }
        draw_help_panel(help_open);
        if (preview->compiling()) draw_notice("compiling shaders ...");
        ImGui::Render();
        gl.BindFramebuffer(GL_FRAMEBUFFER, 0);
        ImGui_ImplOpenGL3_RenderDrawData(ImGui::GetDrawData());
        glfwSwapBuffers(handle);
        apply(edits, turned);
    }

    void apply(const Edits& edits, float turned)
    {
        dirty |= edits.view;
        if (edits.settings) {
            scene.model.settings = view.settings;
            if (scene.model.stacked != view.stacked) {
                scene.model.stacked = view.stacked;
                for (std::size_t fabric = 0; fabric < scene.fabrics.size(); ++fabric) shade_again(scene, fabric);
                preview->yarns_changed();
            }
            preview->model_changed();
            preview->set_options(preview_options());
        }
        if (edits.lights) {
            moved();
            turn_lights(scene, turned);
            preview->lights_changed();
        }
        if (edits.yarns) {
            moved();
            if (shade_again(scene, edits.fabric)) preview->yarns_changed();
        }
        if (edits.geometry) {
            try {
                bake_again(scene, edits.fabric);
                preview->scene_changed();
                status.message.clear();
            } catch (const std::exception& error) {
                status.message = error.what();
            }
        }
    }

    const LookdevOptions& options;
    Scene scene;
    const CameraSpec original;
    CameraSpec camera;
    float exposure;
    GLFWwindow* handle = nullptr;
    GlInfo info;
    std::unique_ptr<Preview> preview;
    ViewPanel view;
    LightPanel light_panel;
    ViewStatus status;
    std::string shader_complaint;
    bool panels_open = true, help_open = false, dirty = false;
    bool blocked = false; // a shader does not compile: nothing to draw until something changes
    int awake = 3;
    int moving_divisor = 1;
    glm::dvec2 pointer{0};
    Clock::time_point last_move = Clock::now() - std::chrono::hours(1), last_look = Clock::now();
};

} // namespace

int run_window(const LookdevOptions& options)
{
    Scene scene = load_scene(options.scene, options.overrides);
    if (!options.quiet)
        for (const std::string& warning : scene.warnings)
            std::fprintf(stderr, "selvedge-lookdev: warning: %s\n", warning.c_str());
    const GlfwLibrary library;
    for (int losses = 0;;) {
        Window window(options, std::move(scene));
        if (window.run()) return 0;
        // A card that resets again and again is of no use.
        if (++losses == 3) throw std::runtime_error("the GL driver has lost the context three times");
        std::fprintf(stderr, "selvedge-lookdev: the GL driver has lost the context; opening another window\n");
        scene = window.take_scene();
    }
}

std::map<std::string, std::string> window_library_versions()
{
    int major = 0, minor = 0, revision = 0;
    glfwGetVersion(&major, &minor, &revision);
    return {{"GLFW", format_text("%d.%d.%d", major, minor, revision)}, {"Dear ImGui", IMGUI_VERSION}};
}

} // namespace selvedge
