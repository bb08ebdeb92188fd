// app/viewport.cpp: camera moves.
#include "app/viewport.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

namespace selvedge
{

Bounds bounds_of(const Scene& scene)
{
    const bool cloth =
        std::any_of(scene.objects.begin(), scene.objects.end(), [](const auto& o) { return o.fabric >= 0; });
    Bounds bounds{glm::vec3(std::numeric_limits<float>::max()), glm::vec3(std::numeric_limits<float>::lowest())};
    for (const SceneObject& object : scene.objects)
        if (object.fabric >= 0 || !cloth)
            for (const glm::vec3& position : object.mesh.positions) {
                bounds.low = glm::min(bounds.low, position);
                bounds.high = glm::max(bounds.high, position);
            }
    return bounds.low.x <= bounds.high.x ? bounds : Bounds{glm::vec3(-1), glm::vec3(1)};
}

CameraSpec orbited(CameraSpec camera, float azimuth, float elevation)
{
    const glm::dvec3 up = glm::normalize(glm::dvec3(camera.up));
    const glm::dvec3 to_eye = glm::dvec3(camera.position) - glm::dvec3(camera.target);
    const double distance = glm::length(to_eye);
    // Any two axes perpendicular to up serve: only differences of the azimuth count.
    const glm::dvec3 side =
        glm::normalize(glm::cross(up, std::abs(up.x) < 0.9 ? glm::dvec3(1, 0, 0) : glm::dvec3(0, 0, 1)));
    const glm::dvec3 front = glm::cross(side, up);
    const double phi = std::atan2(glm::dot(to_eye, side), glm::dot(to_eye, front)) + static_cast<double>(azimuth);
    const double limit = 1.55;
    const double theta =
        std::clamp(std::asin(std::clamp(glm::dot(to_eye, up) / distance, -1.0, 1.0)) + static_cast<double>(elevation),
                   -limit, limit);
    const glm::dvec3 direction =
        (front * std::cos(phi) + side * std::sin(phi)) * std::cos(theta) + up * std::sin(theta);
    camera.position = glm::dvec3(camera.target) + direction * distance;
    return camera;
}

CameraSpec panned(CameraSpec camera, glm::vec2 shift)
{
    const glm::vec3 view = camera.target - camera.position;
    const glm::vec3 right = glm::normalize(glm::cross(view, camera.up));
    const glm::vec3 up = glm::normalize(glm::cross(right, view));
    const float height = 2 * glm::length(view) * std::tan(glm::radians(camera.fov_degrees) / 2);
    const glm::vec3 move = (right * shift.x + up * shift.y) * height;
    camera.position += move;
    camera.target += move;
    return camera;
}

CameraSpec zoomed(CameraSpec camera, float factor)
{
    const glm::vec3 to_eye = camera.position - camera.target;
    const float distance = glm::length(to_eye);
    camera.position = camera.target + to_eye * (std::clamp(distance * factor, 1e-5f, 1e6f) / distance);
    return camera;
}

CameraSpec fitted(CameraSpec camera, const Bounds& bounds, float aspect)
{
    const glm::vec3 direction = glm::normalize(camera.position - camera.target);
    const float radius = std::max(glm::length(bounds.high - bounds.low) / 2, 1e-5f);
    const float half = std::atan(std::tan(glm::radians(camera.fov_degrees) / 2) * std::min(aspect, 1.0f));
    camera.target = (bounds.low + bounds.high) / 2.0f;
    camera.position = camera.target + direction * (radius / std::sin(half));
    return camera;
}

void turn_lights(Scene& scene, float angle)
{
    using namespace cloth::f32;
    const float c = std::cos(angle), s = std::sin(angle);
    for (ClothLight& light : scene.lights) {
        if (light.kind == cloth_light_environment) light.shape.x += angle;
        // The sense in which cloth_environment_direction turns.
        if (light.kind == cloth_light_directional)
            light.axis =
                glm::vec3(c * light.axis.x - s * light.axis.z, light.axis.y, s * light.axis.x + c * light.axis.z);
    }
}

} // namespace selvedge
