// app/preview/gl.hpp: the GL function table, what the driver says of itself, owners of GL objects. Included by
// app/preview/*.cpp and by the window; all calls need the context that load_gl() saw.
#pragma once

#include <string>
#include <utility>

#include <GL/glcorearb.h>

#include "gl_functions.h"

namespace selvedge
{

// Calls read gl.DrawArrays(...).
struct GlFunctions {
#define SELVEDGE_GL_MEMBER(type, name) type name = nullptr;
    SELVEDGE_GL_FUNCTIONS(SELVEDGE_GL_MEMBER)
    SELVEDGE_GL_OPTIONAL(SELVEDGE_GL_MEMBER)
#undef SELVEDGE_GL_MEMBER
};
extern GlFunctions gl;

using GlProc = void (*)();
using GlLoader = GlProc (*)(const char* name);

struct GlInfo {
    std::string vendor, renderer, version;
    int major = 0, minor = 0;
    int texture_limit = 0;        // texels along a side of a picture that can be drawn to
    int buffer_texture_limit = 0; // texels in a buffer texture
    bool software = false;        // the processor draws
    bool clip_control = false;    // depth range [0, 1]: full float precision of reversed depth
    bool compute = false;         // compute shaders that write pictures
    bool compiles_aside = false;  // the driver can be asked whether it has done with a program
};

// Fills the table from the current context and asks the driver about itself; parts the threads of software GL.
//   throws  std::runtime_error: below GL 4.1, or functions missing
GlInfo load_gl(GlLoader loader);

// Whether the driver has given the context up (a reset of the card): everything in it is gone, and nothing will be
// drawn any more. False where the driver cannot say.
bool context_lost();

// Throws std::runtime_error("what: GL_OUT_OF_MEMORY") where an error is pending, all pending errors named.
void check_gl(const char* what);

// Owner of one GL object.
class GlName
{
  public:
    enum class Kind { none, buffer, texture, framebuffer, vertex_array, shader, program };

    GlName() = default;
    explicit GlName(Kind kind);                                     // generates; not for shaders and programs
    GlName(Kind kind, GLuint name) : kind_of(kind), number(name) {} // takes over
    GlName(GlName&& other) noexcept : kind_of(other.kind_of), number(std::exchange(other.number, 0)) {}
    GlName& operator=(GlName&& other) noexcept
    {
        std::swap(kind_of, other.kind_of);
        std::swap(number, other.number);
        return *this;
    }
    ~GlName();

    GLuint operator*() const { return number; }
    explicit operator bool() const { return number != 0; }

  private:
    Kind kind_of = Kind::none;
    GLuint number = 0;
};

// Memory that shaders read through a buffer texture.
class BufferTexture
{
  public:
    // Replaces the content. Nothing is ever empty: zero bytes become one texel of zeros.
    //   format  sized internal format; bytes_per_texel must be its size
    //   throws  std::runtime_error where the driver's limit is exceeded
    void upload(GLenum format, std::size_t bytes_per_texel, const void* data, std::size_t bytes, const char* what,
                const GlInfo& info);
    GLuint texture() const { return *texture_name; }
    std::size_t bytes() const { return size; }

  private:
    GlName buffer, texture_name;
    std::size_t size = 0;
};

} // namespace selvedge
