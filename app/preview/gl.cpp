// app/preview/gl.cpp: loading of GL functions, GL errors, GL objects.
#include "app/preview/gl.hpp"

#include <algorithm>
#include <cstdio>
#include <cstring>
#include <stdexcept>

#include "app/preview/software_threads.hpp"
#include "bake/error.hpp"

namespace selvedge
{

GlFunctions gl;

static std::string text_of(GLenum name)
{
    const GLubyte* text = gl.GetString(name);
    return text != nullptr ? reinterpret_cast<const char*>(text) : "";
}

GlInfo load_gl(GlLoader loader)
{
    std::string missing;
#define SELVEDGE_GL_LOAD(type, name) gl.name = reinterpret_cast<type>(loader("gl" #name));
#define SELVEDGE_GL_REQUIRE(type, name)                                                                                \
    SELVEDGE_GL_LOAD(type, name)                                                                                       \
    if (gl.name == nullptr) missing += " gl" #name;
    SELVEDGE_GL_FUNCTIONS(SELVEDGE_GL_REQUIRE)
    SELVEDGE_GL_OPTIONAL(SELVEDGE_GL_LOAD)
#undef SELVEDGE_GL_REQUIRE
#undef SELVEDGE_GL_LOAD
    if (!missing.empty()) throw std::runtime_error("the GL driver lacks" + missing);

    GlInfo info;
    info.vendor = text_of(GL_VENDOR);
    info.renderer = text_of(GL_RENDERER);
    for (const char* name : {"llvmpipe", "softpipe", "swrast", "SWR", "SwiftShader"})
        info.software |= info.renderer.find(name) != std::string::npos;
    if (info.software) part_software_threads();
    info.version = text_of(GL_VERSION);
    gl.GetIntegerv(GL_MAJOR_VERSION, &info.major);
    gl.GetIntegerv(GL_MINOR_VERSION, &info.minor);
    gl.GetIntegerv(GL_MAX_TEXTURE_SIZE, &info.texture_limit);
    GLint viewport[2] = {};
    gl.GetIntegerv(GL_MAX_VIEWPORT_DIMS, viewport);
    info.texture_limit = std::min({info.texture_limit, viewport[0], viewport[1]});
    gl.GetIntegerv(GL_MAX_TEXTURE_BUFFER_SIZE, &info.buffer_texture_limit);
    if (info.major * 10 + info.minor < 41)
        throw std::runtime_error(
            format_text("found GL %d.%d (%s), expected 4.1 or later", info.major, info.minor, info.renderer.c_str()));
    // The address alone does not say that the context has the feature.
    info.clip_control = info.major * 10 + info.minor >= 45 && gl.ClipControl != nullptr;
    info.compute = info.major * 10 + info.minor >= 43 && gl.DispatchCompute != nullptr &&
                   gl.BindImageTexture != nullptr && gl.MemoryBarrier != nullptr;
    GLint extensions = 0;
    gl.GetIntegerv(GL_NUM_EXTENSIONS, &extensions);
    for (GLint k = 0; k < extensions; ++k) {
        const GLubyte* name = gl.GetStringi(GL_EXTENSIONS, static_cast<GLuint>(k));
        info.compiles_aside |=
            name != nullptr && std::strcmp(reinterpret_cast<const char*>(name), "GL_KHR_parallel_shader_compile") == 0;
    }
    return info;
}

bool context_lost()
{
    return gl.GetGraphicsResetStatus != nullptr && gl.GetGraphicsResetStatus() != GL_NO_ERROR;
}

void check_gl(const char* what)
{
    std::string errors;
    // A lost context may report errors for ever.
    for (int i = 0; i < 8; ++i) {
        const GLenum error = gl.GetError();
        if (error == GL_NO_ERROR) break;
        switch (error) {
        case GL_INVALID_ENUM:
            errors += " GL_INVALID_ENUM";
            break;
        case GL_INVALID_VALUE:
            errors += " GL_INVALID_VALUE";
            break;
        case GL_INVALID_OPERATION:
            errors += " GL_INVALID_OPERATION";
            break;
        case GL_INVALID_FRAMEBUFFER_OPERATION:
            errors += " GL_INVALID_FRAMEBUFFER_OPERATION";
            break;
        case GL_OUT_OF_MEMORY:
            errors += " GL_OUT_OF_MEMORY";
            break;
        default:
            errors += format_text(" GL error 0x%x", error);
        }
    }
    if (!errors.empty()) throw std::runtime_error(std::string(what) + ":" + errors);
}

GlName::GlName(Kind kind) : kind_of(kind)
{
    switch (kind) {
    case Kind::buffer:
        gl.GenBuffers(1, &number);
        break;
    case Kind::texture:
        gl.GenTextures(1, &number);
        break;
    case Kind::framebuffer:
        gl.GenFramebuffers(1, &number);
        break;
    case Kind::vertex_array:
        gl.GenVertexArrays(1, &number);
        break;
    case Kind::none:
    case Kind::shader:
    case Kind::program:
        break;
    }
}

GlName::~GlName()
{
    if (number == 0) return;
    switch (kind_of) {
    case Kind::buffer:
        gl.DeleteBuffers(1, &number);
        break;
    case Kind::texture:
        gl.DeleteTextures(1, &number);
        break;
    case Kind::framebuffer:
        gl.DeleteFramebuffers(1, &number);
        break;
    case Kind::vertex_array:
        gl.DeleteVertexArrays(1, &number);
        break;
    case Kind::shader:
        gl.DeleteShader(number);
        break;
    case Kind::program:
        gl.DeleteProgram(number);
        break;
    case Kind::none:
        break;
    }
}

void BufferTexture::upload(GLenum format, std::size_t bytes_per_texel, const void* data, std::size_t bytes,
                           const char* what, const GlInfo& info)
{
    if (bytes / bytes_per_texel > static_cast<std::size_t>(info.buffer_texture_limit))
        throw std::runtime_error(format_text("%s: %zu texels, but %s holds %d in a buffer texture", what,
                                             bytes / bytes_per_texel, info.renderer.c_str(),
                                             info.buffer_texture_limit));
    const char zeros[16] = {};
    if (bytes == 0) {
        data = zeros;
        bytes = bytes_per_texel;
    }
    if (!buffer) buffer = GlName(GlName::Kind::buffer);
    if (!texture_name) texture_name = GlName(GlName::Kind::texture);
    gl.BindBuffer(GL_TEXTURE_BUFFER, *buffer);
    gl.BufferData(GL_TEXTURE_BUFFER, static_cast<GLsizeiptr>(bytes), data, GL_STATIC_DRAW);
    gl.BindTexture(GL_TEXTURE_BUFFER, *texture_name);
    gl.TexBuffer(GL_TEXTURE_BUFFER, format, *buffer);
    gl.BindBuffer(GL_TEXTURE_BUFFER, 0);
    check_gl(what);
    size = bytes;
}

} // namespace selvedge
