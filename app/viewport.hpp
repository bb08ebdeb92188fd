// app/viewport.hpp: how mouse and keys move the camera. Pure: no GL, no window. Included by window.cpp.
#pragma once

#include <glm/glm.hpp>

#include "reference/scene.hpp"

namespace selvedge
{

struct Bounds {
    glm::vec3 low{0}, high{0};
};

// Of the cloth, or of everything where there is none.
Bounds bounds_of(const Scene& scene);

// Turns the camera about its target: azimuth about `up`, elevation kept short of the poles. Radians.
CameraSpec orbited(CameraSpec camera, float azimuth, float elevation);
// Moves camera and target in the picture plane; (1, 1) is the picture's height to the right and up.
CameraSpec panned(CameraSpec camera, glm::vec2 shift);
// Distance to the target times `factor`, kept off zero and infinity.
CameraSpec zoomed(CameraSpec camera, float factor);
// The same view direction, so far away that the bounds fill the picture. aspect: width / height.
CameraSpec fitted(CameraSpec camera, const Bounds& bounds, float aspect);

// Environment and suns turned about the y axis [rad].
void turn_lights(Scene& scene, float angle);

} // namespace selvedge
