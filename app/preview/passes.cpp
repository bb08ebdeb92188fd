// app/preview/passes.cpp: visibility, shade, merge, present.
#include "app/preview/passes.hpp"

namespace selvedge
{

Passes::Passes(const GlInfo& info)
    : clip_control(info.clip_control), frame_block(GlName::Kind::buffer), empty_array(GlName::Kind::vertex_array)
{
    gl.BindBuffer(GL_UNIFORM_BUFFER, *frame_block);
    gl.BufferData(GL_UNIFORM_BUFFER, sizeof(block::Frame), nullptr, GL_DYNAMIC_DRAW);
}

void Passes::choose(const Needs& needs)
{
    defines = needs.defines();
    model_defines = needs.model_defines();
}

std::vector<std::string> Passes::gauze_defines() const
{
    std::vector<std::string> list = model_defines;
    list.emplace_back("GAPS");
    return list;
}

bool Passes::prepare(const SceneBuffers& buffers)
{
    if (!buffers.opaque.empty()) opaque_visibility.use({});
    if (!buffers.gauze.empty()) gauze_visibility.use(gauze_defines());
    shading.use(defines);
    return opaque_visibility.compiled() && gauze_visibility.compiled() && shading.compiled();
}

void Passes::set_frame(const block::Frame& frame)
{
    gl.BindBuffer(GL_UNIFORM_BUFFER, *frame_block);
    gl.BufferData(GL_UNIFORM_BUFFER, sizeof frame, &frame, GL_DYNAMIC_DRAW);
    gl.BindBufferBase(GL_UNIFORM_BUFFER, 0, *frame_block);
}

void Passes::visibility(Targets& targets, const SceneBuffers& buffers)
{
    gl.Disable(GL_SCISSOR_TEST);
    gl.Disable(GL_CULL_FACE);
    // Only while our own geometry is drawn: the window's other users expect the usual range.
    if (clip_control) gl.ClipControl(GL_LOWER_LEFT, GL_ZERO_TO_ONE);
    targets.begin_visibility();
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
    if (clip_control) gl.ClipControl(GL_LOWER_LEFT, GL_NEGATIVE_ONE_TO_ONE);
}

void Passes::shade(Targets& targets, const SceneBuffers& buffers)
{
    buffers.bind_textures();
    targets.begin_shade();
    gl.UseProgram(*shading.current());
    draw_screen();
    gl.Disable(GL_BLEND);
}

void Passes::merge(Targets& targets, std::uint32_t block_length, std::uint32_t blocks)
{
    merging.use({});
    const ShaderProgram& program = merging.current();
    targets.bind_textures();
    targets.begin_merge();
    gl.UseProgram(*program);
    gl.Uniform1f(program.location("block_length"), static_cast<float>(block_length));
    gl.Uniform1f(program.location("blocks"), static_cast<float>(blocks));
    draw_screen();
    targets.end_merge();
    targets.clear_sum();
}

void Passes::set_weights(const ShaderProgram& program, const ShownWeights& weights)
{
    gl.Uniform1f(program.location("block_weight"), weights.block);
    gl.Uniform1f(program.location("mean_weight"), weights.mean);
    gl.Uniform1f(program.location("samples"), weights.samples);
    gl.Uniform1f(program.location("carried_share"), weights.carried);
}

void Passes::remember(Targets& targets, const SceneBuffers& buffers, const ShownWeights& weights)
{
    remembering.use(model_defines);
    buffers.bind_textures();
    targets.bind_textures();
    targets.begin_remember();
    gl.UseProgram(*remembering.current());
    set_weights(remembering.current(), weights);
    draw_screen();
}

void Passes::carry(Targets& targets, const SceneBuffers& buffers)
{
    carrying.use(model_defines);
    buffers.bind_textures();
    targets.begin_carry();
    targets.bind_textures();
    targets.bind_past();
    gl.UseProgram(*carrying.current());
    draw_screen();
}

void Passes::present(const Targets& targets, glm::ivec2 corner, glm::ivec2 size, const ShownWeights& weights,
                     float exposure)
{
    presenting.use({});
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
    gl.BindVertexArray(*empty_array);
    gl.DrawArrays(GL_TRIANGLES, 0, 3);
}

std::vector<ProgramVariants*> Passes::all()
{
    return {&opaque_visibility, &gauze_visibility, &shading, &merging, &presenting, &remembering, &carrying};
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
