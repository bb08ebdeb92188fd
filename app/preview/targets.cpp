// app/preview/targets.cpp: framebuffers of the preview.
#include "app/preview/targets.hpp"

#include <algorithm>
#include <initializer_list>
#include <stdexcept>

#include "app/preview/shader_source.hpp"
#include "bake/error.hpp"
#include "reference/adaptive.hpp"

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

void Targets::resize(glm::ivec2 size, bool with_tiles, bool with_squares, const GlInfo& info)
{
    size = glm::max(size, glm::ivec2(1));
    const std::size_t wanted_blocks = with_tiles ? 3 : 2;
    if (size == extent && blocks.size() == wanted_blocks && bool(squares) == with_squares) return clear_accumulation();
    if (std::max(size.x, size.y) > info.texture_limit)
        throw std::runtime_error(format_text("resolution %d,%d: %s draws at most %d pixels along a side", size.x,
                                             size.y, info.renderer.c_str(), info.texture_limit));
    extent = glm::ivec2(0);
    for (GlName* name : {&ids, &depth, &visibility_buffer}) *name = GlName(); // made where the rasteriser is asked
    seen = make_texture(GL_RG32UI, GL_RG_INTEGER, GL_UNSIGNED_INT, size);
    sum = make_texture(GL_RGBA32F, GL_RGBA, GL_FLOAT, size);
    squares = GlName();
    if (with_squares) squares = make_texture(GL_RGBA32F, GL_RGBA, GL_FLOAT, size);
    sum_buffer = with_squares ? make_framebuffer({*sum, *seen, *squares}, 0) : make_framebuffer({*sum, *seen}, 0);
    blocks.clear();
    for (std::size_t k = 0; k < wanted_blocks; ++k) {
        Blocks& made = blocks.emplace_back();
        for (GlName* texture : {&made.mean, &made.spread, &made.rest})
            *texture = make_texture(GL_RGBA32F, GL_RGBA, GL_FLOAT, size);
        made.buffer = make_framebuffer({*made.mean, *made.spread, *made.rest}, 0);
    }
    current[0] = 0;
    current[1] = wanted_blocks - 2;
    spare = wanted_blocks - 1;
    extent = size;
    for (GlName* name : {&kept, &kept_noise, &tile_spread, &kept_buffer, &tile_buffer}) *name = GlName();
    if (with_tiles) {
        kept = make_texture(GL_RGBA32F, GL_RGBA, GL_FLOAT, size);
        kept_noise = make_texture(GL_RGBA32F, GL_RGBA, GL_FLOAT, size);
        kept_buffer = make_framebuffer({*kept, *kept_noise}, 0);
        tile_spread = make_texture(GL_RGBA32F, GL_RGBA, GL_FLOAT, tiles());
        tile_buffer = make_framebuffer({*tile_spread}, 0);
    }
    check_gl("framebuffers");
    clear_accumulation();
}

glm::ivec2 Targets::tiles() const
{
    return (extent + (tile_side - 1)) / tile_side;
}

static void begin_writing(GLuint framebuffer, glm::ivec2 size)
{
    gl.BindFramebuffer(GL_FRAMEBUFFER, framebuffer);
    gl.Viewport(0, 0, size.x, size.y);
    for (const GLenum test : {GL_DEPTH_TEST, GL_BLEND, GL_SCISSOR_TEST, GL_CULL_FACE}) gl.Disable(test);
}

static void begin_adding(GLuint framebuffer, glm::ivec2 size)
{
    begin_writing(framebuffer, size);
    gl.Enable(GL_BLEND);
    gl.BlendFunc(GL_ONE, GL_ONE);
}

void Targets::clear_accumulation()
{
    clear_sum();
    const float zeros[4] = {};
    if (squares) gl.ClearBufferfv(GL_COLOR, 2, zeros);
    for (std::size_t k = 0; k < blocks.size(); ++k) {
        if (k == spare) continue;
        gl.BindFramebuffer(GL_FRAMEBUFFER, *blocks[k].buffer);
        for (GLint picture = 0; picture < 3; ++picture) gl.ClearBufferfv(GL_COLOR, picture, zeros);
    }
    if (!kept) return;
    gl.BindFramebuffer(GL_FRAMEBUFFER, *kept_buffer);
    for (GLint picture = 0; picture < 2; ++picture) gl.ClearBufferfv(GL_COLOR, picture, zeros);
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
    begin_depth(0);
    gl.ClearBufferuiv(GL_COLOR, 0, nothing);
    gl.DepthFunc(GL_GREATER);
}

void Targets::begin_uncover()
{
    begin_depth(1);
    gl.DepthFunc(GL_ALWAYS);
}

void Targets::end_uncover()
{
    gl.DepthFunc(GL_GREATER);
}

void Targets::begin_depth(float depth_everywhere)
{
    if (!visibility_buffer) {
        ids = make_texture(GL_RGBA32UI, GL_RGBA_INTEGER, GL_UNSIGNED_INT, extent);
        depth = make_texture(GL_DEPTH_COMPONENT32F, GL_DEPTH_COMPONENT, GL_FLOAT, extent);
        visibility_buffer = make_framebuffer({*ids}, *depth);
        gl.BindFramebuffer(GL_FRAMEBUFFER, *sum_buffer);
        gl.FramebufferTexture2D(GL_FRAMEBUFFER, GL_DEPTH_ATTACHMENT, GL_TEXTURE_2D, *depth, 0);
        check_gl("identities");
    }
    begin_writing(*visibility_buffer, extent);
    gl.Enable(GL_DEPTH_TEST);
    gl.DepthMask(GL_TRUE);
    gl.ClearBufferfv(GL_DEPTH, 0, &depth_everywhere);
}

void Targets::begin_shade()
{
    begin_adding(*sum_buffer, extent);
}

void Targets::begin_shade(bool found)
{
    begin_shade();
    gl.Enable(GL_DEPTH_TEST);
    gl.DepthMask(GL_FALSE);
    gl.DepthRange(0, 0); // whatever is drawn lies infinitely far away, as does what the rasteriser has left
    gl.DepthFunc(found ? GL_LESS : GL_EQUAL);
}

void Targets::end_shade()
{
    gl.Disable(GL_BLEND);
    gl.Disable(GL_DEPTH_TEST);
    gl.DepthMask(GL_TRUE);
    gl.DepthRange(0, 1);
}

void Targets::begin_dispatch()
{
    const std::pair<GLuint, GLenum> images[] = {{*sum, GL_RGBA32F}, {*seen, GL_RG32UI}, {*squares, GL_RGBA32F}};
    GLuint unit = 0;
    for (const auto& [texture, format] : images)
        gl.BindImageTexture(unit++, texture, 0, GL_FALSE, 0, GL_READ_WRITE, format);
}

void Targets::begin_merge()
{
    begin_writing(*blocks[spare].buffer, extent);
}

void Targets::end_merge(int half)
{
    std::swap(current[half], spare);
}

void Targets::begin_keep()
{
    begin_adding(*kept_buffer, extent);
}

void Targets::begin_judge()
{
    begin_writing(*tile_buffer, tiles());
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
    begin_writing(*past_buffer, extent);
}

void Targets::begin_carry()
{
    if (carried_extent != extent) {
        carried_extent = glm::ivec2(0);
        carried = make_texture(GL_RGBA32F, GL_RGBA, GL_FLOAT, extent);
        carried_buffer = make_framebuffer({*carried}, 0);
        carried_extent = extent;
    }
    begin_writing(*carried_buffer, extent);
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

void Targets::bind_textures(int half) const
{
    const Blocks& own = blocks[current[half]];
    const std::pair<const char*, GLuint> textures[] = {
        {"id_map", *ids},        {"block_sum", *sum},       {"mean_map", *own.mean}, {"spread_map", *own.spread},
        {"rest_map", *own.rest}, {"carried_map", *carried}, {"seen_map", *seen}};
    for (const auto& [name, texture] : textures) bind_texture(name, texture);
    if (!kept) return;
    const Blocks& odd = blocks[current[1]];
    bind_texture("odd_mean_map", *odd.mean);
    bind_texture("odd_spread_map", *odd.spread);
    bind_texture("kept_map", *kept);
    bind_texture("kept_noise_map", *kept_noise);
}

static void read_framebuffer(GLuint framebuffer, GLenum attachment, glm::ivec2 size, float* pixels)
{
    gl.BindFramebuffer(GL_FRAMEBUFFER, framebuffer);
    gl.ReadBuffer(GL_COLOR_ATTACHMENT0 + attachment);
    gl.PixelStorei(GL_PACK_ALIGNMENT, 4);
    gl.ReadPixels(0, 0, size.x, size.y, GL_RGBA, GL_FLOAT, pixels);
    check_gl("reading the picture");
}

void Targets::read(Picture which, int half, float* pixels) const
{
    const bool of_kept = which == Picture::kept || which == Picture::kept_noise;
    const bool of_sum = which == Picture::sum || which == Picture::squares;
    const GLuint framebuffer = of_sum ? *sum_buffer : of_kept ? *kept_buffer : *blocks[current[half]].buffer;
    const bool second = which == Picture::spread || which == Picture::kept_noise;
    read_framebuffer(framebuffer, which == Picture::squares ? 2 : second ? 1 : 0, extent, pixels);
}

void Targets::read_tiles(float* tile_pixels) const
{
    read_framebuffer(*tile_buffer, 0, tiles(), tile_pixels);
}

void Targets::show(const float* pixels)
{
    if (!denoised) denoised = make_texture(GL_RGB32F, GL_RGB, GL_FLOAT, extent);
    gl.BindTexture(GL_TEXTURE_2D, *denoised);
    gl.PixelStorei(GL_UNPACK_ALIGNMENT, 4);
    gl.TexImage2D(GL_TEXTURE_2D, 0, GL_RGB32F, extent.x, extent.y, 0, GL_RGB, GL_FLOAT, pixels);
    bind_texture("denoised_map", *denoised);
    check_gl("the filtered picture");
}

} // namespace selvedge
