// bake/display.cpp: OpenColorIO through the image library, and the default beside it.
#include "display.hpp"

#include <algorithm>
#include <cctype>
#include <cmath>
#include <cstdlib>
#include <limits>

#include <OpenImageIO/color.h>

#include "error.hpp"
#include "glsl/cloth_bsdf.hpp"

namespace selvedge
{

namespace
{

// Names of linear Rec.709 in the configurations of ACES 1.0 and 1.3, Blender, OpenColorIO 2 and older studios.
constexpr const char* rec709_names[] = {
    "Linear Rec.709 (sRGB)",      "lin_rec709_scene", "lin_rec709", "lin_rec709_srgb", "Utility - Linear - sRGB",
    "Utility - Linear - Rec.709", "Linear Rec.709",   "lin_srgb",   "linear_rec709",   "linear_srgb"};

std::string lower(std::string text)
{
    for (char& c : text) c = char(std::tolower(static_cast<unsigned char>(c)));
    return text;
}

} // namespace

DisplayTransform DisplayTransform::of_environment()
{
    DisplayTransform transform;
    transform.name_ = "Khronos PBR Neutral, sRGB";
    const char* variable = std::getenv("OCIO");
    if (!variable || *variable == '\0') return transform;
    const std::string path = variable;
    OIIO::ColorConfig config(path);
    if (config.has_error()) {
        std::string reason = config.geterror();
        std::replace(reason.begin(), reason.end(), '\n', ' ');
        throw InputError(path, 0, "found no OpenColorIO configuration that $OCIO could mean: %s", reason.c_str());
    }
    std::string space;
    for (const std::string& known : config.getColorSpaceNames())
        for (const char* name : rec709_names)
            if (space.empty() && lower(known) == lower(name)) space = known;
    if (space.empty()) {
        const char* role = config.getColorSpaceNameByRole("scene_linear");
        if (!role) throw InputError(path, 0, "found neither linear Rec.709 nor a role scene_linear ($OCIO)");
        space = role;
    }
    const char* display = config.getDefaultDisplayName();
    const char* view = display ? config.getDefaultViewName(display) : nullptr;
    if (!display || !view) throw InputError(path, 0, "found no display with a view ($OCIO)");
    const OIIO::ColorProcessorHandle processor = config.createDisplayTransform(display, view, space);
    if (!processor) {
        std::string reason = config.geterror();
        std::replace(reason.begin(), reason.end(), '\n', ' ');
        throw InputError(path, 0, "found no way from %s to %s, %s ($OCIO): %s", space.c_str(), display, view,
                         reason.c_str());
    }
    transform.processor_ = processor;
    transform.name_ = "OpenColorIO " + path + ": " + display + ", " + std::string(view) + ", from " + space;
    return transform;
}

void DisplayTransform::apply(float* colours, std::size_t count, float exposure) const
{
    if (!processor_) {
        for (std::size_t k = 0; k < count; ++k) {
            float* c = colours + 3 * k;
            const glm::vec3 shown = cloth::f32::cloth_display(glm::vec3(c[0], c[1], c[2]), exposure);
            c[0] = shown.x, c[1] = shown.y, c[2] = shown.z;
        }
        return;
    }
    const float gain = std::exp2(exposure);
    for (std::size_t k = 0; k < 3 * count; ++k) colours[k] *= gain;
    const auto& processor = *static_cast<const OIIO::ColorProcessor*>(processor_.get());
    constexpr std::size_t row = 1 << 16; // the library counts pixels in int
    for (std::size_t first = 0; first < count; first += row)
        processor.apply(colours + 3 * first, int(std::min(row, count - first)), 1, 3, sizeof(float), 3 * sizeof(float),
                        OIIO::stride_t(3 * sizeof(float) * row));
    // NaN stays visible as magenta, as in the default.
    for (std::size_t k = 0; k < count; ++k) {
        float* c = colours + 3 * k;
        if (std::isnan(c[0] + c[1] + c[2])) c[0] = 1.0f, c[1] = 0.0f, c[2] = 1.0f;
    }
}

} // namespace selvedge
