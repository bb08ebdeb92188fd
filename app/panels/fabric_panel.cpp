// app/panels/fabric_panel.cpp: yarns of the scene's fabrics. Rows come from bake/params.hpp.
#include <algorithm>
#include <cstdio>

#include <imgui.h>

#include "app/panels/panels.hpp"
#include "bake/params.hpp"

namespace selvedge
{

static void draw_colour(const char* label, glm::vec3& colour, bool& changed)
{
    changed |= ImGui::ColorEdit3(label, &colour.x, ImGuiColorEditFlags_Float | ImGuiColorEditFlags_DisplayHSV);
}

// What the file left open follows from other values until it is asked for.
static void draw_colour(const char* label, std::optional<glm::vec3>& colour, glm::vec3 otherwise, bool& changed)
{
    bool own = colour.has_value();
    ImGui::PushID(label);
    if (ImGui::Checkbox("##own", &own)) {
        if (own)
            colour = otherwise;
        else
            colour.reset();
        changed = true;
    }
    ImGui::SameLine();
    if (colour)
        draw_colour(label, *colour, changed);
    else
        ImGui::TextDisabled("%s: derived", label);
    ImGui::PopID();
}

static void draw_yarn(YarnSpec& yarn, bool& shading, bool& geometry)
{
    for (const YarnParam& row : yarn_params) {
        const bool wide = row.low > 0 && row.high > 50 * row.low;
        // ImGui takes the finest step of a logarithmic slider from the digits of its format.
        const bool moved = ImGui::SliderFloat(row.key, &(yarn.*row.member), row.low, row.high,
                                              row.low < 0.001f && wide ? "%.6f" : "%.3f",
                                              (wide ? ImGuiSliderFlags_Logarithmic : 0) | ImGuiSliderFlags_AlwaysClamp);
        if (ImGui::IsItemHovered()) ImGui::SetTooltip("%s [%s]", row.help, row.unit);
        // A bake is asked for when the slider is let go.
        if (row.geometry)
            geometry |= ImGui::IsItemDeactivatedAfterEdit();
        else
            shading |= moved;
    }
    ImGui::SliderInt("plies", &yarn.plies, 1, ply_limit, "%d", ImGuiSliderFlags_AlwaysClamp);
    geometry |= ImGui::IsItemDeactivatedAfterEdit();
    for (const Section& row : yarn_sections) {
        ImGui::BeginDisabled(row.section == YarnSection::racetrack && yarn.aspect > 1);
        if (ImGui::RadioButton(row.name, yarn.section == row.section) && yarn.section != row.section) {
            yarn.section = row.section;
            geometry = true;
        }
        ImGui::EndDisabled();
        ImGui::SameLine();
    }
    ImGui::NewLine();
    if (yarn.section == YarnSection::racetrack) yarn.aspect = std::min(yarn.aspect, 1.0f);
    draw_colour("albedo", yarn.albedo, shading);
    draw_colour("albedo, transmission", yarn.albedo_transmission, yarn.albedo, shading);
    draw_colour("diffuse", yarn.diffuse, glm::vec3(0.1f), shading);
    draw_colour("diffuse, transmission", yarn.diffuse_transmission, glm::vec3(0.0f), shading);
}

void draw_fabric_panel(Scene& scene, Edits& edits)
{
    for (std::size_t k = 0; k < scene.fabric_sources.size(); ++k) {
        Fabric& fabric = scene.fabric_sources[k];
        const PackedFabric& packed = scene.fabrics[k];
        char title[160];
        std::snprintf(title, sizeof title, "Fabric: %.100s###fabric%zu", fabric.name.c_str(), k);
        if (!ImGui::CollapsingHeader(title, k == 0 ? ImGuiTreeNodeFlags_DefaultOpen : 0)) continue;
        ImGui::PushID(static_cast<int>(k));
        ImGui::TextDisabled("%s, %d x %d texels, gaps %.1f %%", fabric.pattern.c_str(), packed.size.x, packed.size.y,
                            100 * static_cast<double>(packed.gap_cover));
        bool shading = false, geometry = false;
        for (const auto& [name, yarn] : {std::pair{"warp", &fabric.warp}, {"weft", &fabric.weft}})
            if (ImGui::TreeNodeEx(name, ImGuiTreeNodeFlags_DefaultOpen)) {
                draw_yarn(*yarn, shading, geometry);
                ImGui::TreePop();
            }
        ImGui::PopID();
        if (!shading && !geometry) continue;
        edits.fabric = k;
        edits.yarns |= shading;
        edits.geometry |= geometry;
    }
}

} // namespace selvedge
