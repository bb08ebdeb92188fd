// app/preview/targets.cpp: framebuffers of the preview.
#include "app/preview/targets.hpp"

#include <algorithm>
#include <initializer_list>
#include <stdexcept>

#include "app/preview/shader_source.hpp"
#include "bake/error.hpp"

namespace selvedge
{

static GlName make_texture(GLenum format, GLenum channels, GLenum type, glm::ivec2 size)
{
    GlName texture(GlName::Kind::texture);
    gl.BindTexture(GL_TEXTURE_2D, *texture);
    gl.TexImage2D(GL_TEXTURE_2D, 0, static_cast<GLint>(format), size.x, size.y, 0, channels, type, nullptr);
    for (const GLenum filter : {GL_TEXTURE_MIN_FILTER, GL_TEXTURE_MAG_FILTER})
        gl.TexParameteri(GL_TEXTURE_2D, filter, GL_NEAREST);
    return texture;
}

static GlName make_framebuffer(std::initializer_list<GLuint> colours, GLuint depth)
{
    GlName framebuffer(GlName::Kind::framebuffer);
    gl.BindFramebuffer(GL_FRAMEBUFFER, *framebuffer);
    GLenum buffers[4];
    GLsizei count = 0;
    for (const GLuint colour : colours) {
        buffers[count] = GL_COLOR_ATTACHMENT0 + static_cast<GLenum>(count);
        gl.FramebufferTexture2D(GL_FRAMEBUFFER, buffers[count], GL_TEXTURE_2D, colour, 0);
        ++count;
    }
    if (depth != 0) gl.FramebufferTexture2D(GL_FRAMEBUFFER, GL_DEPTH_ATTACHMENT, GL_TEXTURE_2D, depth, 0);
    gl.DrawBuffers(count, buffers);
    const GLenum status = gl.CheckFramebufferStatus(GL_FRAMEBUFFER);
    if (status != GL_FRAMEBUFFER_COMPLETE)
        throw std::runtime_error(format_text("the GL driver refuses a float framebuffer (status 0x%x)", status));
    return framebuffer;
}

void Targets::resize(glm::ivec2 size, const GlInfo& info)
{
    size = glm::max(size, glm::ivec2(1));
    if (size == extent) return clear_accumulation();
    if (std::max(size.x, size.y) > info.texture_limit)
        throw std::runtime_error(format_text("resolution %d,%d: %s draws at most %d pixels along a side", size.x,
                                             size.y, info.renderer.c_str(), info.texture_limit));
    extent = glm::ivec2(0);
    ids = make_texture(GL_RGBA32UI, GL_RGBA_INTEGER, GL_UNSIGNED_INT, size);
    depth = make_texture(GL_DEPTH_COMPONENT32F, GL_DEPTH_COMPONENT, GL_FLOAT, size);
    sum = make_texture(GL_RGBA32F, GL_RGBA, GL_FLOAT, size);
    visibility_buffer = make_framebuffer({*ids}, *depth);
    sum_buffer = make_framebuffer({*sum}, 0);
    for (int side = 0; side < 2; ++side) {
        mean[side] = make_texture(GL_RGBA32F, GL_RGBA, GL_FLOAT, size);
        spread[side] = make_texture(GL_RGBA32F, GL_RGBA, GL_FLOAT, size);
        rest[side] = make_texture(GL_RGBA32F, GL_RGBA, GL_FLOAT, size);
        merge_buffer[side] = make_framebuffer({*mean[side], *spread[side], *rest[side]}, 0);
    }
    check_gl("framebuffers");
    extent = size;
    clear_accumulation();
}

void Targets::clear_accumulation()
{
    clear_sum();
    const float zeros[4] = {};
    gl.BindFramebuffer(GL_FRAMEBUFFER, *merge_buffer[current]);
    gl.ClearBufferfv(GL_COLOR, 0, zeros);
    gl.ClearBufferfv(GL_COLOR, 1, zeros);
    gl.ClearBufferfv(GL_COLOR, 2, zeros);
}

void Targets::clear_sum()
{
    const float zeros[4] = {};
    gl.BindFramebuffer(GL_FRAMEBUFFER, *sum_buffer);
    gl.ClearBufferfv(GL_COLOR, 0, zeros);
}

void Targets::begin_visibility()
{
    const GLuint nothing[4] = {};
    const float far = 0;
    gl.BindFramebuffer(GL_FRAMEBUFFER, *visibility_buffer);
    gl.Viewport(0, 0, extent.x, extent.y);
    gl.DepthMask(GL_TRUE);
    gl.ClearBufferuiv(GL_COLOR, 0, nothing);
    gl.ClearBufferfv(GL_DEPTH, 0, &far);
    gl.Enable(GL_DEPTH_TEST);
    gl.DepthFunc(GL_GREATER);
    gl.Disable(GL_BLEND);
}

void Targets::begin_shade()
{
    gl.BindFramebuffer(GL_FRAMEBUFFER, *sum_buffer);
    gl.Viewport(0, 0, extent.x, extent.y);
    gl.Disable(GL_DEPTH_TEST);
    gl.Enable(GL_BLEND);
    gl.BlendFunc(GL_ONE, GL_ONE);
}

void Targets::begin_merge()
{
    gl.BindFramebuffer(GL_FRAMEBUFFER, *merge_buffer[1 - current]);
    gl.Viewport(0, 0, extent.x, extent.y);
    gl.Disable(GL_DEPTH_TEST);
    gl.Disable(GL_BLEND);
}

void Targets::end_merge()
{
    current = 1 - current;
}

void Targets::begin_remember()
{
    if (past_extent != extent) {
        past_extent = glm::ivec2(0);
        past_picture = make_texture(GL_RGBA32F, GL_RGBA, GL_FLOAT, extent);
        past_place = make_texture(GL_RGBA32F, GL_RGBA, GL_FLOAT, extent);
        past_buffer = make_framebuffer({*past_picture, *past_place}, 0);
        past_extent = extent;
    }
    gl.BindFramebuffer(GL_FRAMEBUFFER, *past_buffer);
    gl.Viewport(0, 0, extent.x, extent.y);
    gl.Disable(GL_DEPTH_TEST);
    gl.Disable(GL_BLEND);
}

void Targets::begin_carry()
{
    if (carried_extent != extent) {
        carried_extent = glm::ivec2(0);
        carried = make_texture(GL_RGBA32F, GL_RGBA, GL_FLOAT, extent);
        carried_buffer = make_framebuffer({*carried}, 0);
        carried_extent = extent;
    }
    gl.BindFramebuffer(GL_FRAMEBUFFER, *carried_buffer);
    gl.Viewport(0, 0, extent.x, extent.y);
    gl.Disable(GL_DEPTH_TEST);
    gl.Disable(GL_BLEND);
}

static void bind_texture(const char* name, GLuint texture)
{
    gl.ActiveTexture(GL_TEXTURE0 + static_cast<GLenum>(texture_unit(name)));
    gl.BindTexture(GL_TEXTURE_2D, texture);
    gl.ActiveTexture(GL_TEXTURE0);
}

void Targets::bind_past() const
{
    bind_texture("past_picture", *past_picture);
    bind_texture("past_place", *past_place);
}

void Targets::bind_textures() const
{
    const std::pair<const char*, GLuint> textures[] = {{"id_map", *ids},
                                                       {"block_sum", *sum},
                                                       {"mean_map", *mean[current]},
                                                       {"spread_map", *spread[current]},
                                                       {"rest_map", *rest[current]},
                                                       {"carried_map", *carried}};
    for (const auto& [name, texture] : textures) bind_texture(name, texture);
}

void Targets::read(int which, float* pixels) const
{
    gl.BindFramebuffer(GL_FRAMEBUFFER, which == 0 ? *sum_buffer : *merge_buffer[current]);
    gl.ReadBuffer(which == 2 ? GL_COLOR_ATTACHMENT1 : GL_COLOR_ATTACHMENT0);
    gl.PixelStorei(GL_PACK_ALIGNMENT, 4);
    gl.ReadPixels(0, 0, extent.x, extent.y, GL_RGBA, GL_FLOAT, pixels);
    check_gl("reading the picture");
}

} // namespace selvedge
