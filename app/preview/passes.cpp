// app/preview/passes.cpp: visibility, shade, merge, judge, keep, present.
#include "app/preview/passes.hpp"

#include <algorithm>
#include <utility>

#include "app/preview/block_nodes.hpp"
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
    light_defines = needs.light_defines();
    model_defines = needs.model_defines();
    seen_alone = needs.seen;
    std::vector<std::string> of_picture;
    if (squares) of_picture.emplace_back("SQUARES");
    if (tiles) of_picture.emplace_back("TILES");
    if (camera_rays && seen_alone) of_picture.push_back("BLOCK_SIDE " + std::to_string(block_side));
    for (std::vector<std::string>* list : {&defines, &light_defines})
        list->insert(list->end(), of_picture.begin(), of_picture.end());
    defines = dispatch_defines(std::move(defines));
    backdrop_drawn = false;
    drawn_tiles.clear();
    seeing_blocks.clear();
    lay_out({1, 1});
}

// Of the passes that know nothing of the scene.
std::vector<std::string> Passes::screen_defines() const
{
    return tiled ? std::vector<std::string>{"TILES"} : std::vector<std::string>{};
}

void Passes::set_tiles(glm::ivec2 size, const std::vector<bool>& drawn)
{
    drawn_tiles = drawn;
    if (computes) {
        const std::vector<std::uint8_t> flags(drawn.begin(), drawn.end());
        tile_flags.upload(GL_R8UI, 1, flags.data(), flags.size(), "tiles", info);
    }
    lay_out(size);
}

void Passes::set_blocks(glm::ivec2 size, const std::vector<bool>& seeing)
{
    seeing_blocks = seeing;
    lay_out(size);
}

// Adds a rectangle for each run of neighbours in a row.
//   is_in  of column and row
template <typename IsIn>
static void append_squares(std::vector<glm::vec2>& vertices, glm::ivec2 size, int side, IsIn&& is_in)
{
    const glm::ivec2 count = (size + (side - 1)) / side;
    for (int y = 0; y < count.y; ++y)
        for (int x = 0, end; x < count.x; x = end) {
            end = x + 1;
            if (!is_in(x, y)) continue;
            while (end < count.x && is_in(end, y)) ++end;
            const glm::vec2 low = glm::vec2(glm::ivec2(x, y) * side) / glm::vec2(size) * 2.0f - 1.0f;
            const glm::vec2 high =
                glm::vec2(glm::min(glm::ivec2(end, y + 1) * side, size)) / glm::vec2(size) * 2.0f - 1.0f;
            for (const glm::vec2 corner : {low, {high.x, low.y}, high, low, high, {low.x, high.y}})
                vertices.push_back(corner);
        }
}

void Passes::lay_out(glm::ivec2 size)
{
    static_assert(tile_side % block_side == 0, "a block lies in one tile");
    std::vector<glm::vec2> vertices = {{-1, -1}, {3, -1}, {-1, 3}, {-1, -1}, {-1, -1}, {-1, -1}};
    const Run whole = {0, 3};
    const auto append = [&](int side, auto&& is_in) {
        const std::size_t first = vertices.size();
        append_squares(vertices, size, side, is_in);
        return Run{static_cast<GLint>(first), static_cast<GLsizei>(vertices.size() - first)};
    };
    const auto is_drawn = [&](int x, int y) {
        const int columns = (size.x + tile_side - 1) / tile_side;
        return drawn_tiles.empty() || drawn_tiles[static_cast<std::size_t>(y * columns + x)];
    };
    const auto sees = [&](int x, int y) { return seeing_blocks[static_cast<std::size_t>(y * blocks_of(size).x + x)]; };
    const auto block_is_drawn = [&](int x, int y) {
        return is_drawn(x * block_side / tile_side, y * block_side / tile_side);
    };
    const auto has_none = [](const std::vector<bool>& flags, bool value) {
        return std::find(flags.begin(), flags.end(), value) == flags.end();
    };
    tile_run = has_none(drawn_tiles, false) ? whole : append(tile_side, is_drawn);
    seeing_run = tile_run;
    blind_run = {};
    if (!has_none(seeing_blocks, false)) {
        seeing_run = append(block_side, [&](int x, int y) { return block_is_drawn(x, y) && sees(x, y); });
        blind_run = append(block_side, [&](int x, int y) { return block_is_drawn(x, y) && !sees(x, y); });
    }
    gl.BindVertexArray(*screen_array);
    if (!corners) {
        corners = GlName(GlName::Kind::buffer);
        gl.BindBuffer(GL_ARRAY_BUFFER, *corners);
        gl.EnableVertexAttribArray(0);
        gl.VertexAttribPointer(0, 2, GL_FLOAT, GL_FALSE, 0, nullptr);
    }
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
    if (seen_alone && !computes) need(backdrop, light_defines);
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
    if (std::find(drawn_tiles.begin(), drawn_tiles.end(), false) == drawn_tiles.end()) {
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
    if (!seen_alone || camera_rays) {
        targets.begin_shade();
        draw_run(shading.current(), seeing_run);
        if (blind_run.count > 0) draw_run(backdrop.current(), blind_run);
        // Software GL compiles a program when it is first drawn with: not when a view settles.
        if (seen_alone && !std::exchange(backdrop_drawn, true)) draw_run(backdrop.current(), empty_run);
    } else {
        targets.begin_shade(true);
        draw_run(shading.current(), tile_run);
        targets.begin_shade(false);
        draw_run(backdrop.current(), tile_run);
    }
    targets.end_shade();
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
    gl.BindVertexArray(*screen_array);
    gl.DrawArrays(GL_TRIANGLES, tile_run.first, tile_run.count);
}

void Passes::draw_run(const ShaderProgram& program, Run run)
{
    gl.UseProgram(*program);
    gl.BindVertexArray(*screen_array);
    gl.DrawArrays(GL_TRIANGLES, run.first, run.count);
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
    return {&opaque_visibility, &gauze_visibility, &shading,  &computed_shading, &backdrop,   &merging,
            &presenting,        &remembering,      &carrying, &judging,          &uncovering, &keeping};
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
