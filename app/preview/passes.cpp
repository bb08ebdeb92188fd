// app/preview/passes.cpp: visibility, shade, merge, judge, keep, present.
#include "app/preview/passes.hpp"

#include <algorithm>

#include "reference/adaptive.hpp"

namespace selvedge
{

// Pixels of a work group: a warp of NVIDIA's cards. 32 to 64 in any shape took the same time within 3 % (docs/gpu.md).
static constexpr glm::ivec2 dispatch_group(8, 4);

Passes::Passes(const GlInfo& gl_info)
    : info(gl_info), frame_block(GlName::Kind::buffer), screen_array(GlName::Kind::vertex_array)
{
    gl.BindBuffer(GL_UNIFORM_BUFFER, *frame_block);
    gl.BufferData(GL_UNIFORM_BUFFER, sizeof(block::Frame), nullptr, GL_DYNAMIC_DRAW);
}

void Passes::choose(const Needs& needs, bool tiles, bool squares, bool by_computing)
{
    tiled = tiles;
    computes = by_computing;
    camera_rays = needs.camera_rays;
    defines = needs.defines();
    model_defines = needs.model_defines();
    if (squares) defines.emplace_back("SQUARES");
    defines = dispatch_defines(std::move(defines));
    tile_corners = tiles ? tile_corners : 0;
    if (!tiles) return;
    defines.emplace_back("TILES");
    if (corners) return;
    corners = GlName(GlName::Kind::buffer);
    gl.BindVertexArray(*screen_array);
    gl.BindBuffer(GL_ARRAY_BUFFER, *corners);
    gl.EnableVertexAttribArray(0);
    gl.VertexAttribPointer(0, 2, GL_FLOAT, GL_FALSE, 0, nullptr);
    set_tiles({1, 1}, {true});
}

// Of the passes that know nothing of the scene.
std::vector<std::string> Passes::screen_defines() const
{
    return tiled ? std::vector<std::string>{"TILES"} : std::vector<std::string>{};
}

void Passes::set_tiles(glm::ivec2 size, const std::vector<bool>& drawn)
{
    std::vector<glm::vec2> vertices = {{-1, -1}, {3, -1}, {-1, 3}};
    const std::size_t whole = vertices.size();
    const int columns = (size.x + tile_side - 1) / tile_side, rows = (size.y + tile_side - 1) / tile_side;
    const auto is_drawn = [&](int x, int y) { return drawn[static_cast<std::size_t>(y * columns + x)]; };
    if (std::find(drawn.begin(), drawn.end(), false) != drawn.end()) {
        // One rectangle for each run of neighbours in a row.
        for (int y = 0; y < rows; ++y)
            for (int x = 0, end; x < columns; x = end) {
                end = x + 1;
                if (!is_drawn(x, y)) continue;
                while (end < columns && is_drawn(end, y)) ++end;
                const glm::vec2 low = glm::vec2(glm::ivec2(x, y) * tile_side) / glm::vec2(size) * 2.0f - 1.0f;
                const glm::vec2 high =
                    glm::vec2(glm::min(glm::ivec2(end, y + 1) * tile_side, size)) / glm::vec2(size) * 2.0f - 1.0f;
                for (const glm::vec2 corner : {low, {high.x, low.y}, high, low, high, {low.x, high.y}})
                    vertices.push_back(corner);
            }
    }
    if (computes) {
        const std::vector<std::uint8_t> flags(drawn.begin(), drawn.end());
        tile_flags.upload(GL_R8UI, 1, flags.data(), flags.size(), "tiles", info);
    }
    tile_corners = static_cast<GLsizei>(vertices.size() - whole);
    gl.BindBuffer(GL_ARRAY_BUFFER, *corners);
    gl.BufferData(GL_ARRAY_BUFFER, static_cast<GLsizeiptr>(vertices.size() * sizeof vertices[0]), vertices.data(),
                  GL_DYNAMIC_DRAW);
}

std::vector<std::string> Passes::view_defines() const
{
    std::vector<std::string> list = model_defines;
    if (tiled) list.emplace_back("TILES");
    return list;
}

std::vector<std::string> Passes::dispatch_defines(std::vector<std::string> own) const
{
    if (!computes) return own;
    own.push_back("GROUP_X " + std::to_string(dispatch_group.x));
    own.push_back("GROUP_Y " + std::to_string(dispatch_group.y));
    own.push_back("TILE_SIDE " + std::to_string(tile_side));
    return own;
}

std::vector<std::string> Passes::gauze_defines() const
{
    std::vector<std::string> list = model_defines;
    list.emplace_back("GAPS");
    return list;
}

bool Passes::prepare(const SceneBuffers& buffers, bool waits)
{
    std::vector<ProgramVariants*> needed;
    const auto need = [&](ProgramVariants& programs, const std::vector<std::string>& with) {
        programs.use_soon(with, info); // all at once, where the driver can
        needed.push_back(&programs);
    };
    need(computes ? computed_shading : shading, defines);
    if (!camera_rays && !buffers.opaque.empty()) need(opaque_visibility, {});
    if (!camera_rays && !buffers.gauze.empty()) need(gauze_visibility, gauze_defines());
    bool compiled = true;
    for (ProgramVariants* programs : needed) {
        if (waits) programs->finish();
        compiled &= programs->compiled();
    }
    return compiled;
}

bool Passes::compiling()
{
    const std::vector<ProgramVariants*> programs = all();
    return std::any_of(programs.begin(), programs.end(), [](const ProgramVariants* one) { return one->compiling(); });
}

void Passes::set_frame(const block::Frame& frame)
{
    gl.BindBuffer(GL_UNIFORM_BUFFER, *frame_block);
    gl.BufferData(GL_UNIFORM_BUFFER, sizeof frame, &frame, GL_DYNAMIC_DRAW);
    gl.BindBufferBase(GL_UNIFORM_BUFFER, 0, *frame_block);
}

void Passes::visibility(Targets& targets, const SceneBuffers& buffers)
{
    // Only while our own geometry is drawn: the window's other users expect the usual range.
    if (info.clip_control) gl.ClipControl(GL_LOWER_LEFT, GL_ZERO_TO_ONE);
    if (tile_corners == 0) {
        targets.begin_visibility();
    } else {
        uncovering.use(screen_defines());
        targets.begin_uncover();
        gl.UseProgram(*uncovering.current());
        draw_tiles();
        targets.end_uncover();
    }
    // Opaque objects first: what lies behind them need not be looked up.
    const std::pair<ProgramVariants*, const std::vector<std::size_t>*> kinds[] = {{&opaque_visibility, &buffers.opaque},
                                                                                  {&gauze_visibility, &buffers.gauze}};
    for (const auto& [programs, objects] : kinds) {
        if (objects->empty()) continue;
        const ShaderProgram& program = programs->current();
        gl.UseProgram(*program);
        const GLint object_index = program.location("object_index");
        for (const std::size_t object : *objects) {
            if (buffers.index_count(object) == 0) continue;
            gl.Uniform1i(object_index, static_cast<GLint>(object));
            buffers.bind_object(object);
            gl.DrawElements(GL_TRIANGLES, buffers.index_count(object), GL_UNSIGNED_INT, nullptr);
        }
    }
    if (info.clip_control) gl.ClipControl(GL_LOWER_LEFT, GL_NEGATIVE_ONE_TO_ONE);
}

void Passes::shade(Targets& targets, const SceneBuffers& buffers)
{
    buffers.bind_textures();
    if (computes) return dispatch(computed_shading.current(), targets);
    targets.begin_shade();
    gl.UseProgram(*shading.current());
    draw_tiles();
    gl.Disable(GL_BLEND);
}

void Passes::merge(Targets& targets, int half, std::uint32_t block_length, std::uint32_t blocks)
{
    merging.use(screen_defines());
    const ShaderProgram& program = merging.current();
    targets.bind_textures(half);
    targets.begin_merge();
    gl.UseProgram(*program);
    gl.Uniform1f(program.location("block_length"), static_cast<float>(block_length));
    gl.Uniform1f(program.location("blocks"), static_cast<float>(blocks));
    draw_tiles();
    targets.end_merge(half);
    targets.clear_sum();
}

void Passes::judge(Targets& targets)
{
    judging.use(screen_defines());
    targets.bind_textures();
    targets.begin_judge();
    gl.UseProgram(*judging.current());
    gl.Uniform1i(judging.current().location("side"), tile_side);
    draw_screen();
}

void Passes::keep(Targets& targets, int half, std::uint32_t blocks)
{
    keeping.use(screen_defines());
    targets.bind_textures(half);
    targets.begin_keep();
    gl.UseProgram(*keeping.current());
    gl.Uniform1f(keeping.current().location("blocks"), static_cast<float>(blocks));
    draw_tiles();
    gl.Disable(GL_BLEND);
}

void Passes::set_weights(const ShaderProgram& program, const ShownWeights& weights)
{
    gl.Uniform1f(program.location("block_weight"), weights.block);
    gl.Uniform1f(program.location("mean_weight"), weights.mean);
    gl.Uniform1f(program.location("odd_mean_weight"), weights.odd_mean);
    gl.Uniform1f(program.location("samples"), weights.samples);
    gl.Uniform1f(program.location("carried_share"), weights.carried);
}

void Passes::remember(Targets& targets, const SceneBuffers& buffers, const ShownWeights& weights)
{
    remembering.use(view_defines());
    buffers.bind_textures();
    targets.bind_textures();
    targets.begin_remember();
    gl.UseProgram(*remembering.current());
    set_weights(remembering.current(), weights);
    draw_screen();
}

void Passes::carry(Targets& targets, const SceneBuffers& buffers)
{
    carrying.use(view_defines());
    buffers.bind_textures();
    targets.begin_carry();
    targets.bind_textures();
    targets.bind_past();
    gl.UseProgram(*carrying.current());
    draw_screen();
}

void Passes::present(const Targets& targets, glm::ivec2 corner, glm::ivec2 size, const ShownWeights& weights,
                     float exposure, bool denoised)
{
    std::vector<std::string> wanted = screen_defines();
    if (denoised) wanted.emplace_back("DENOISED");
    presenting.use(wanted);
    const ShaderProgram& program = presenting.current();
    targets.bind_textures();
    gl.Disable(GL_DEPTH_TEST);
    gl.Disable(GL_BLEND);
    gl.Disable(GL_FRAMEBUFFER_SRGB); // the display transform has encoded already
    gl.Viewport(corner.x, corner.y, size.x, size.y);
    gl.UseProgram(*program);
    set_weights(program, weights);
    gl.Uniform1f(program.location("exposure"), exposure);
    gl.Uniform1f(program.location("left"), static_cast<float>(corner.x));
    gl.Uniform1f(program.location("top"), static_cast<float>(corner.y + size.y));
    gl.Uniform1f(program.location("stretch_x"), static_cast<float>(targets.size().x) / static_cast<float>(size.x));
    gl.Uniform1f(program.location("stretch_y"), static_cast<float>(targets.size().y) / static_cast<float>(size.y));
    draw_screen();
}

void Passes::draw_screen()
{
    gl.BindVertexArray(*screen_array);
    gl.DrawArrays(GL_TRIANGLES, 0, 3);
}

void Passes::draw_tiles()
{
    if (tile_corners == 0) return draw_screen();
    gl.BindVertexArray(*screen_array);
    gl.DrawArrays(GL_TRIANGLES, 3, tile_corners);
}

void Passes::dispatch(const ShaderProgram& program, Targets& targets)
{
    gl.UseProgram(*program);
    if (tiled) {
        gl.ActiveTexture(GL_TEXTURE0 + static_cast<GLenum>(texture_unit("drawn_tiles")));
        gl.BindTexture(GL_TEXTURE_BUFFER, tile_flags.texture());
        gl.ActiveTexture(GL_TEXTURE0);
    }
    targets.begin_dispatch();
    const glm::uvec2 groups = (targets.size() + dispatch_group - 1) / dispatch_group;
    gl.DispatchCompute(groups.x, groups.y, 1);
    // What comes next reads textures, adds to images, clears and reads framebuffers.
    gl.MemoryBarrier(GL_TEXTURE_FETCH_BARRIER_BIT | GL_SHADER_IMAGE_ACCESS_BARRIER_BIT | GL_FRAMEBUFFER_BARRIER_BIT);
}

std::vector<ProgramVariants*> Passes::all()
{
    return {&opaque_visibility, &gauze_visibility, &shading, &computed_shading, &merging, &presenting,
            &remembering,       &carrying,         &judging, &uncovering,       &keeping};
}

bool Passes::rebuild_if_changed()
{
    bool any = false;
    for (ProgramVariants* programs : all()) any |= programs->rebuild_if_changed();
    return any;
}

std::string Passes::complaint()
{
    std::string text;
    for (const ProgramVariants* programs : all())
        if (const std::string one = programs->complaint(); !one.empty()) text += (text.empty() ? "" : "\n") + one;
    return text;
}

} // namespace selvedge
