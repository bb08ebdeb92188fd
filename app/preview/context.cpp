// app/preview/context.cpp: EGL (device, surfaceless, default display) and OSMesa contexts. The only file that includes
// either.
#include "app/preview/context.hpp"

#include <algorithm>
#include <cstring>
#include <stdexcept>
#include <vector>

#include <EGL/egl.h>
#include <EGL/eglext.h>
#include <dlfcn.h>

#include "bake/error.hpp"

namespace selvedge
{
namespace
{

constexpr int versions[][2] = {{4, 5}, {4, 3}, {4, 1}};

// ---- EGL ------------------------------------------------------------------------------------------------------------

bool has_word(const char* list, const char* word)
{
    const std::size_t length = std::strlen(word);
    for (const char* at = list; at != nullptr && (at = std::strstr(at, word)) != nullptr; at += length)
        if ((at == list || at[-1] == ' ') && (at[length] == '\0' || at[length] == ' ')) return true;
    return false;
}

struct Display {
    std::string name;
    EGLDisplay display;
};

// In the order in which they are worth a try: graphics cards, software devices, Mesa without any device, the default.
std::vector<Display> displays()
{
    std::vector<Display> cards, software;
    const char* extensions = eglQueryString(EGL_NO_DISPLAY, EGL_EXTENSIONS);
    const auto platform_display =
        reinterpret_cast<PFNEGLGETPLATFORMDISPLAYEXTPROC>(eglGetProcAddress("eglGetPlatformDisplayEXT"));
    if (platform_display != nullptr && has_word(extensions, "EGL_EXT_platform_device")) {
        const auto query_devices = reinterpret_cast<PFNEGLQUERYDEVICESEXTPROC>(eglGetProcAddress("eglQueryDevicesEXT"));
        const auto query_string =
            reinterpret_cast<PFNEGLQUERYDEVICESTRINGEXTPROC>(eglGetProcAddress("eglQueryDeviceStringEXT"));
        EGLDeviceEXT devices[16];
        EGLint count = 0;
        if (query_devices != nullptr && query_devices(16, devices, &count) == EGL_TRUE)
            for (EGLint i = 0; i < count; ++i) {
                const char* of_device = query_string != nullptr ? query_string(devices[i], EGL_EXTENSIONS) : "";
                auto& list = has_word(of_device, "EGL_MESA_device_software") ? software : cards;
                list.push_back(
                    {format_text("EGL device %d", i), platform_display(EGL_PLATFORM_DEVICE_EXT, devices[i], nullptr)});
            }
    }
    cards.insert(cards.end(), software.begin(), software.end());
    if (platform_display != nullptr && has_word(extensions, "EGL_MESA_platform_surfaceless"))
        cards.push_back({"EGL surfaceless", platform_display(EGL_PLATFORM_SURFACELESS_MESA, nullptr, nullptr)});
    cards.push_back({"EGL default display", eglGetDisplay(EGL_DEFAULT_DISPLAY)});
    return cards;
}

class EglContext : public Context
{
  public:
    // Empty where it works, otherwise why it does not.
    std::string open(EGLDisplay candidate)
    {
        EGLint major = 0, minor = 0;
        if (candidate == EGL_NO_DISPLAY) return "no display";
        if (eglInitialize(candidate, &major, &minor) != EGL_TRUE)
            return format_text("eglInitialize: 0x%x", eglGetError());
        display = candidate;
        if (eglBindAPI(EGL_OPENGL_API) != EGL_TRUE) return "no desktop OpenGL";
        const EGLint wanted[] = {EGL_SURFACE_TYPE, EGL_PBUFFER_BIT, EGL_RENDERABLE_TYPE, EGL_OPENGL_BIT, EGL_NONE};
        EGLConfig config = nullptr;
        EGLint count = 0;
        eglChooseConfig(display, wanted, &config, 1, &count);
        // A driver that can tell that it has lost the context is asked to; not all take the question.
        for (const auto& version : versions)
            for (const bool notified : {true, false}) {
                std::vector<EGLint> attributes = {EGL_CONTEXT_MAJOR_VERSION,       version[0],
                                                  EGL_CONTEXT_MINOR_VERSION,       version[1],
                                                  EGL_CONTEXT_OPENGL_PROFILE_MASK, EGL_CONTEXT_OPENGL_CORE_PROFILE_BIT};
                if (notified)
                    attributes.insert(attributes.end(),
                                      {EGL_CONTEXT_OPENGL_RESET_NOTIFICATION_STRATEGY, EGL_LOSE_CONTEXT_ON_RESET});
                attributes.push_back(EGL_NONE);
                if (context == EGL_NO_CONTEXT)
                    context = eglCreateContext(display, count > 0 ? config : EGL_NO_CONFIG_KHR, EGL_NO_CONTEXT,
                                               attributes.data());
            }
        if (context == EGL_NO_CONTEXT) return format_text("no core context 4.1 or later: 0x%x", eglGetError());
        // We draw to framebuffers of our own; a surface of one pixel serves drivers that insist on one.
        if (eglMakeCurrent(display, EGL_NO_SURFACE, EGL_NO_SURFACE, context) == EGL_TRUE) return "";
        const EGLint one_pixel[] = {EGL_WIDTH, 1, EGL_HEIGHT, 1, EGL_NONE};
        if (count > 0) surface = eglCreatePbufferSurface(display, config, one_pixel);
        if (surface != EGL_NO_SURFACE && eglMakeCurrent(display, surface, surface, context) == EGL_TRUE) return "";
        return format_text("eglMakeCurrent: 0x%x", eglGetError());
    }

    ~EglContext() override
    {
        if (display == EGL_NO_DISPLAY) return;
        eglMakeCurrent(display, EGL_NO_SURFACE, EGL_NO_SURFACE, EGL_NO_CONTEXT);
        if (surface != EGL_NO_SURFACE) eglDestroySurface(display, surface);
        if (context != EGL_NO_CONTEXT) eglDestroyContext(display, context);
        eglTerminate(display);
    }

  private:
    EGLDisplay display = EGL_NO_DISPLAY;
    EGLContext context = EGL_NO_CONTEXT;
    EGLSurface surface = EGL_NO_SURFACE;
};

// ---- OSMesa: loaded when asked for, so that a machine without it runs the rest and nobody waits for LLVM in vain ---

// Values of GL/osmesa.h, which cannot be included beside GL/glcorearb.h.
constexpr int osmesa_format = 0x22, osmesa_rgba = GL_RGBA, osmesa_depth_bits = 0x30, osmesa_profile = 0x33,
              osmesa_core_profile = 0x34, osmesa_major = 0x36, osmesa_minor = 0x37;

GlProc (*osmesa_address)(const char*) = nullptr;

class OsmesaContext : public Context
{
  public:
    std::string open()
    {
        for (const char* name : {"libOSMesa.so.8", "libOSMesa.so"})
            if (library == nullptr) library = dlopen(name, RTLD_NOW | RTLD_LOCAL);
        if (library == nullptr) return "libOSMesa.so.8 not found";
        const auto create =
            reinterpret_cast<void* (*)(const int*, void*)>(dlsym(library, "OSMesaCreateContextAttribs"));
        const auto make_current = reinterpret_cast<GLboolean (*)(void*, void*, GLenum, GLsizei, GLsizei)>(
            dlsym(library, "OSMesaMakeCurrent"));
        osmesa_address = reinterpret_cast<GlProc (*)(const char*)>(dlsym(library, "OSMesaGetProcAddress"));
        destroy = reinterpret_cast<void (*)(void*)>(dlsym(library, "OSMesaDestroyContext"));
        if (create == nullptr || make_current == nullptr || osmesa_address == nullptr || destroy == nullptr)
            return "libOSMesa is too old: no OSMesaCreateContextAttribs";
        for (const auto& version : versions) {
            const int attributes[] = {
                osmesa_format, osmesa_rgba,  osmesa_depth_bits, 0, osmesa_profile, osmesa_core_profile, osmesa_major,
                version[0],    osmesa_minor, version[1],        0};
            context = create(attributes, nullptr);
            if (context != nullptr) break;
        }
        if (context == nullptr) return "no core context 4.1 or later";
        pixels.resize(16 * 16 * 4);
        if (make_current(context, pixels.data(), GL_UNSIGNED_BYTE, 16, 16) != GL_TRUE)
            return "OSMesaMakeCurrent failed";
        return "";
    }

    // The library stays loaded: Mesa's threads may still be in it.
    ~OsmesaContext() override
    {
        if (context != nullptr) destroy(context);
    }

  private:
    void* library = nullptr;
    void* context = nullptr;
    void (*destroy)(void*) = nullptr;
    std::vector<unsigned char> pixels;
};

} // namespace

std::unique_ptr<Context> Context::create(Backend backend)
{
    std::string tried;
    if (backend != Backend::osmesa)
        for (const Display& candidate : displays()) {
            auto context = std::make_unique<EglContext>();
            std::string reason = context->open(candidate.display);
            if (reason.empty()) {
                try {
                    context->info = load_gl([](const char* name) { return eglGetProcAddress(name); });
                    context->backend = "egl";
                    return context;
                } catch (const std::runtime_error& error) {
                    reason = error.what();
                }
            }
            tried += "\n  " + candidate.name + ": " + reason;
        }
    if (backend != Backend::egl) {
        auto context = std::make_unique<OsmesaContext>();
        std::string reason = context->open();
        if (reason.empty()) {
            try {
                context->info = load_gl([](const char* name) { return osmesa_address(name); });
                context->backend = "osmesa";
                return context;
            } catch (const std::runtime_error& error) {
                reason = error.what();
            }
        }
        tried += "\n  OSMesa: " + reason;
    }
    throw std::runtime_error("no OpenGL 4.1 context without a window; tried" + tried);
}

Backend parse_backend(const std::string& word)
{
    if (word == "auto") return Backend::automatic;
    if (word == "egl") return Backend::egl;
    if (word == "osmesa") return Backend::osmesa;
    throw UsageError("--backend: found '%s', expected auto, egl or osmesa", word.c_str());
}

} // namespace selvedge
