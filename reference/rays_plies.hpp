// Rays against meshes that stand in the scene many times: the tubes of a fabric's repeat, and what is beside them.
// plies.cpp includes it. Beside rays.cpp, rays_plies.cpp is the only file that includes Embree: rays.cpp knows sheets
// of cloth, this one instances.
#pragma once

#include <cstdint>
#include <memory>
#include <vector>

#include <glm/glm.hpp>

namespace selvedge
{

struct InstancedMesh {
    std::vector<glm::vec3> positions;
    std::vector<glm::uvec3> triangles; // counter-clockwise seen from outside
};

struct Instance {
    std::uint32_t mesh = 0;
    glm::mat4x3 to_world{1}; // columns x, y, z, origin; not mirrored
};

// Queries may run in any number of threads at once; they allocate nothing.
class InstancedRays
{
  public:
    struct Hit {
        bool any = false;
        std::uint32_t instance = 0, triangle = 0;
        float u = 0, v = 0; // barycentric coordinates of the second and third corner
        float distance = 0; // in lengths of the direction, which need not be unit
    };

    InstancedRays(const std::vector<InstancedMesh>& meshes, const std::vector<Instance>& instances);
    ~InstancedRays();
    InstancedRays(const InstancedRays&) = delete;
    InstancedRays& operator=(const InstancedRays&) = delete;

    // First triangle with distance in [near, far], in lengths of `direction`.
    Hit closest(glm::vec3 origin, glm::vec3 direction, float near, float far) const;

  private:
    struct State;
    std::unique_ptr<State> state_;
};

} // namespace selvedge
