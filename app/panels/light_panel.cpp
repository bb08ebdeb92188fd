// app/panels/light_panel.cpp: lights of the scene.
#include <imgui.h>

#include "app/panels/panels.hpp"

namespace selvedge
{

void draw_light_panel(LightPanel& panel, Scene& scene, Edits& edits, float& turned)
{
    using namespace cloth::f32;
    if (!ImGui::CollapsingHeader("Lights", ImGuiTreeNodeFlags_DefaultOpen)) return;
    const float before = panel.turn_degrees;
    if (ImGui::SliderFloat("turn", &panel.turn_degrees, -180, 180, "%.0f deg")) {
        turned += glm::radians(panel.turn_degrees - before);
        edits.lights = true;
    }
    if (ImGui::IsItemHovered())
        ImGui::SetTooltip("environment and sun together; Ctrl + drag in the picture does it, too");
    static constexpr const char* kinds[] = {"environment", "directional", "point", "spot", "area", "flash", "object"};
    for (std::size_t k = 0; k < scene.lights.size(); ++k) {
        ClothLight& light = scene.lights[k];
        ImGui::PushID(static_cast<int>(k));
        edits.lights |= ImGui::DragFloat3(kinds[light.kind], &light.radiance.x, 0.01f, 0, 1e6f, "%.3g",
                                          ImGuiSliderFlags_Logarithmic | ImGuiSliderFlags_AlwaysClamp);
        ImGui::PopID();
    }
}

} // namespace selvedge
