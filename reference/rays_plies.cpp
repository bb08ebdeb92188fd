// Instances of the plies, by Embree.
#include "reference/rays_plies.hpp"

#include "reference/embree.hpp"

namespace selvedge
{

struct InstancedRays::State {
    RTCDevice device = nullptr;
    RTCScene scene = nullptr;
    std::vector<RTCScene> prototypes;

    ~State()
    {
        if (scene) rtcReleaseScene(scene);
        for (RTCScene prototype : prototypes) rtcReleaseScene(prototype);
        if (device) rtcReleaseDevice(device);
    }
};

InstancedRays::InstancedRays(const std::vector<InstancedMesh>& meshes, const std::vector<Instance>& instances)
    : state_(std::make_unique<State>())
{
    State& state = *state_;
    state.device = new_device();
    for (const InstancedMesh& mesh : meshes) {
        RTCScene prototype = rtcNewScene(state.device);
        state.prototypes.push_back(prototype);
        rtcSetSceneFlags(prototype, RTC_SCENE_FLAG_ROBUST);
        // High quality would split triangles; a crossing is counted, so it must not be seen twice.
        rtcSetSceneBuildQuality(prototype, RTC_BUILD_QUALITY_MEDIUM);
        RTCGeometry geometry = new_triangles(state.device, mesh.positions, mesh.triangles);
        rtcCommitGeometry(geometry);
        rtcAttachGeometry(prototype, geometry);
        rtcReleaseGeometry(geometry);
        commit_alone(prototype);
    }
    state.scene = rtcNewScene(state.device);
    rtcSetSceneFlags(state.scene, RTC_SCENE_FLAG_ROBUST);
    for (std::size_t k = 0; k < instances.size(); ++k) {
        RTCGeometry geometry = rtcNewGeometry(state.device, RTC_GEOMETRY_TYPE_INSTANCE);
        rtcSetGeometryInstancedScene(geometry, state.prototypes[instances[k].mesh]);
        rtcSetGeometryTransform(geometry, 0, RTC_FORMAT_FLOAT3X4_COLUMN_MAJOR, &instances[k].to_world[0][0]);
        rtcCommitGeometry(geometry);
        rtcAttachGeometryByID(state.scene, geometry, unsigned(k));
        rtcReleaseGeometry(geometry);
    }
    commit_alone(state.scene);
    throw_on_error(state.device);
}

InstancedRays::~InstancedRays() = default;

InstancedRays::Hit InstancedRays::closest(glm::vec3 origin, glm::vec3 direction, float near, float far) const
{
    const RTCRayHit query = first_hit(state_->scene, origin, direction, near, far);
    if (query.hit.geomID == RTC_INVALID_GEOMETRY_ID) return {};
    return {true, query.hit.instID[0], query.hit.primID, query.hit.u, query.hit.v, query.ray.tfar};
}

} // namespace selvedge
