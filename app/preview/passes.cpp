// app/preview/passes.cpp: visibility, shade, merge, present.
#include "app/preview/passes.hpp"

namespace selvedge
{

Passes::Passes(const GlInfo& info)
    : clip_control(info.clip_control), merging("screen.vert", "merge.frag"), frame_block(GlName::Kind::buffer),
      empty_array(GlName::Kind::vertex_array)
{
    gl.BindBuffer(GL_UNIFORM_BUFFER, *frame_block);
    gl.BufferData(GL_UNIFORM_BUFFER, sizeof(block::Frame), nullptr, GL_DYNAMIC_DRAW);
}

void Passes::choose(const SceneBuffers& buffers, const Scene& scene, int footprint_samples)
{
    // What the model evaluates and which lights there are is compiled in: software GL runs both sides of every branch.
    const cloth::f32::ClothSettings& settings = scene.model.settings;
    std::vector<std::string> model;
    const auto define = [&](const char* name, int value) { model.push_back(name + (" " + std::to_string(value))); };
    define("MODEL_BSDF", settings.bsdf);
    define("MODEL_WEIGHT", settings.weight);
    define("MODEL_VISIBILITY", settings.visibility);
    define("MODEL_SLAB", settings.slab);
    define("MODEL_UNSCATTERED", settings.unscattered);
    define("MODEL_INTERREFLECTION", settings.interreflection);
    define("MODEL_TWIST_NOISE", settings.twist_noise);
    int kinds = 0;
    for (const cloth::f32::ClothLight& light : scene.lights) kinds |= 1 << light.kind;
    define("CLOTH_LIGHT_KINDS", kinds);
    std::vector<std::string> wanted = model;
    if (buffers.has_fabric) wanted.emplace_back("FABRIC");
    if (buffers.has_gaps) wanted.emplace_back("GAPS");
    if (buffers.has_fabric && footprint_samples > 1) wanted.emplace_back("FOOTPRINT");
    if (buffers.has_matte) wanted.emplace_back("MATTE");
    if (!*shading || wanted != defines) {
        shading = ShaderProgram("screen.vert", "shade.frag", wanted);
        defines = wanted;
    }
    if (!*opaque_visibility && !buffers.opaque.empty())
        opaque_visibility = ShaderProgram("visibility.vert", "visibility.frag");
    model.emplace_back("GAPS");
    if (!buffers.gauze.empty() && (!*gauze_visibility || model != gauze_defines)) {
        gauze_visibility = ShaderProgram("visibility.vert", "visibility.frag", model);
        gauze_defines = model;
    }
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
    const std::pair<const ShaderProgram*, const std::vector<std::size_t>*> kinds[] = {
        {&opaque_visibility, &buffers.opaque}, {&gauze_visibility, &buffers.gauze}};
    for (const auto& [program, objects] : kinds) {
        if (objects->empty()) continue;
        gl.UseProgram(**program);
        const GLint object_index = program->location("object_index");
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
    gl.UseProgram(*shading);
    draw_screen();
    gl.Disable(GL_BLEND);
}

void Passes::merge(Targets& targets, std::uint32_t block_length, std::uint32_t blocks)
{
    targets.bind_textures();
    targets.begin_merge();
    gl.UseProgram(*merging);
    gl.Uniform1f(merging.location("block_length"), static_cast<float>(block_length));
    gl.Uniform1f(merging.location("blocks"), static_cast<float>(blocks));
    draw_screen();
    targets.end_merge();
    targets.clear_sum();
}

void Passes::present(const Targets& targets, glm::ivec2 corner, glm::ivec2 size, float block_weight, float mean_weight,
                     float exposure)
{
    if (!*presenting) presenting = ShaderProgram("screen.vert", "present.frag");
    targets.bind_textures();
    gl.Disable(GL_DEPTH_TEST);
    gl.Disable(GL_BLEND);
    gl.Viewport(corner.x, corner.y, size.x, size.y);
    gl.UseProgram(*presenting);
    gl.Uniform1f(presenting.location("block_weight"), block_weight);
    gl.Uniform1f(presenting.location("mean_weight"), mean_weight);
    gl.Uniform1f(presenting.location("exposure"), exposure);
    gl.Uniform1f(presenting.location("left"), static_cast<float>(corner.x));
    gl.Uniform1f(presenting.location("top"), static_cast<float>(corner.y + size.y));
    gl.Uniform1f(presenting.location("stretch_x"), static_cast<float>(targets.size().x) / static_cast<float>(size.x));
    gl.Uniform1f(presenting.location("stretch_y"), static_cast<float>(targets.size().y) / static_cast<float>(size.y));
    draw_screen();
}

void Passes::draw_screen()
{
    gl.BindVertexArray(*empty_array);
    gl.DrawArrays(GL_TRIANGLES, 0, 3);
}

bool Passes::rebuild_if_changed(std::string& complaint)
{
    bool any = false;
    complaint.clear();
    for (ShaderProgram* program : {&opaque_visibility, &gauze_visibility, &shading, &merging, &presenting}) {
        if (**program == 0) continue;
        any |= program->rebuild_if_changed();
        if (!program->complaint().empty()) complaint += (complaint.empty() ? "" : "\n") + program->complaint();
    }
    return any;
}

} // namespace selvedge
