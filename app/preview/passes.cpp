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
    gauze_defines = needs.model_defines();
    gauze_defines.emplace_back("GAPS");
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
    struct Kind {
        ProgramVariants& programs;
        const std::vector<std::string> with;
        const std::vector<std::size_t>& objects;
    };
    for (const Kind& kind :
         {Kind{opaque_visibility, {}, buffers.opaque}, Kind{gauze_visibility, gauze_defines, buffers.gauze}}) {
        if (kind.objects.empty()) continue;
        kind.programs.use(kind.with);
        const ShaderProgram& program = kind.programs.current();
        gl.UseProgram(*program);
        const GLint object_index = program.location("object_index");
        for (const std::size_t object : kind.objects) {
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
    shading.use(defines);
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

void Passes::present(const Targets& targets, glm::ivec2 corner, glm::ivec2 size, float block_weight, float mean_weight,
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
    gl.Uniform1f(program.location("block_weight"), block_weight);
    gl.Uniform1f(program.location("mean_weight"), mean_weight);
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

bool Passes::rebuild_if_changed()
{
    bool any = false;
    for (ProgramVariants* programs : {&opaque_visibility, &gauze_visibility, &shading, &merging, &presenting})
        any |= programs->rebuild_if_changed();
    return any;
}

std::string Passes::complaint() const
{
    std::string text;
    for (const ProgramVariants* programs : {&opaque_visibility, &gauze_visibility, &shading, &merging, &presenting})
        if (const std::string one = programs->complaint(); !one.empty()) text += (text.empty() ? "" : "\n") + one;
    return text;
}

} // namespace selvedge
