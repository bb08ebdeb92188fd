// app/panels/view_panel.cpp: what is evaluated, how it is shown, how far it has come; the help.
#include <cstdio>

#include <imgui.h>

#include "app/panels/panels.hpp"

namespace selvedge
{

void draw_view_panel(ViewPanel& panel, const ViewStatus& status, float& exposure, Edits& edits)
{
    using namespace cloth::f32;
    ImGui::Text("%u samples  %d x %d  %.1f ms a frame", status.frames, status.resolution.x, status.resolution.y,
                status.milliseconds);
    ImGui::Text("%.0f %% of the picture finished", 100 * status.done);
    ImGui::TextDisabled("%s", status.renderer.c_str());
    if (!status.message.empty()) ImGui::TextWrapped("%s", status.message.c_str());
    if (!ImGui::CollapsingHeader("View", ImGuiTreeNodeFlags_DefaultOpen)) return;
    edits.view |= ImGui::SliderFloat("exposure", &exposure, -8, 8, "%.1f stops");
    edits.settings |= ImGui::Combo("BSDF", &panel.settings.bsdf, "micro\0meso\0");
    edits.settings |= ImGui::Combo("weight", &panel.settings.weight, "relief\0resample\0mips\0tile\0");
    edits.settings |= ImGui::Combo("slab", &panel.settings.slab, "ply\0macro\0");
    edits.settings |= ImGui::Checkbox("unscattered", &panel.settings.unscattered);
    edits.settings |= ImGui::Checkbox("stacked yarns", &panel.stacked);
    edits.settings |= ImGui::Checkbox("interreflection", &panel.settings.interreflection);
    edits.settings |= ImGui::Checkbox("twist noise", &panel.settings.twist_noise);
    edits.settings |=
        ImGui::SliderInt("samples a frame", &panel.footprint_samples, 1, 16, "%d", ImGuiSliderFlags_AlwaysClamp);
    edits.settings |= ImGui::Checkbox("light that bounces", &panel.paths);
    if (panel.paths)
        edits.settings |= ImGui::SliderInt("surfaces", &panel.max_depth, 2, 1024, "%d along a path",
                                           ImGuiSliderFlags_Logarithmic | ImGuiSliderFlags_AlwaysClamp);
    int divisor = panel.divisor == 1 ? 0 : panel.divisor == 2 ? 1 : 2;
    if (ImGui::Combo("resolution", &divisor, "full\0half\0quarter\0")) panel.divisor = 1 << divisor;
    ImGui::Checkbox("coarser while moving", &panel.coarse_while_moving);
    edits.view |= ImGui::Checkbox("denoise", &panel.denoise);
    ImGui::SliderInt("rest after", &panel.sample_limit, 16, 65536, "%d samples",
                     ImGuiSliderFlags_Logarithmic | ImGuiSliderFlags_AlwaysClamp);
    ImGui::Checkbox("paused", &panel.paused);
}

void draw_notice(const char* text)
{
    ImGui::SetNextWindowPos(ImGui::GetMainViewport()->GetCenter(), ImGuiCond_Always, ImVec2(0.5f, 0.5f));
    if (ImGui::Begin("notice", nullptr,
                     ImGuiWindowFlags_AlwaysAutoResize | ImGuiWindowFlags_NoDecoration | ImGuiWindowFlags_NoInputs))
        ImGui::TextUnformatted(text);
    ImGui::End();
}

void draw_help_panel(bool& open)
{
    if (!open) return;
    ImGui::SetNextWindowPos(ImGui::GetMainViewport()->GetCenter(), ImGuiCond_Appearing, ImVec2(0.5f, 0.5f));
    if (ImGui::Begin("Help", &open, ImGuiWindowFlags_AlwaysAutoResize)) {
        static constexpr const char* rows[][2] = {
            {"left drag", "orbit"},
            {"middle drag, Shift + left drag", "pan"},
            {"wheel, right drag", "zoom"},
            {"Ctrl + left drag, Shift + right drag", "turn the lights"},
            {"F", "fit the cloth into the picture"},
            {"R", "reset the camera"},
            {"E, Shift + E", "exposure up, down half a stop"},
            {"Space", "pause"},
            {"P", "panels on, off"},
            {"F12", "save the picture"},
            {"H, ?", "this help"},
        };
        if (ImGui::BeginTable("keys", 2)) {
            for (const auto& [key, action] : rows) {
                ImGui::TableNextColumn();
                ImGui::TextUnformatted(key);
                ImGui::TableNextColumn();
                ImGui::TextUnformatted(action);
            }
            ImGui::EndTable();
        }
    }
    ImGui::End();
}

} // namespace selvedge
