// bake/display.hpp: from scene-linear colours to those of a display. What writes pictures for people goes through it;
// metrics use glsl/color.h, which no environment variable changes.
#pragma once

#include <cstddef>
#include <memory>
#include <string>

namespace selvedge
{

// OpenColorIO's default display and view of the configuration that $OCIO names; where it names none, the Khronos PBR
// Neutral curve and sRGB (cloth_display in glsl/color.h).
class DisplayTransform
{
  public:
    // Linear Rec.709 is looked for in a configuration under its usual names; one that knows none of them is given its
    // role scene_linear, and name() says so.
    //   throws  InputError: the configuration is missing or broken, or has no such space, display or view
    static DisplayTransform of_environment();

    // "OpenColorIO CONFIG: DISPLAY, VIEW, from SPACE", or "Khronos PBR Neutral, sRGB"; for headers of pictures
    const std::string& name() const { return name_; }

    // Linear Rec.709 radiance to display values, in place: `count` times r, g, b.
    //   exposure  stops
    void apply(float* colours, std::size_t count, float exposure) const;

  private:
    std::string name_;
    std::shared_ptr<const void> processor_; // of OpenColorIO; empty: the default
};

} // namespace selvedge
