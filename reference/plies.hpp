// Ground truth below the model: paths among the plies themselves. Where the surface model has maps of a fabric, here
// stand the tubes that the maps are projections of, instanced repeat by repeat over a plane or a cylinder, with the
// point BSDF of glsl/ on their surface. integrator.cpp and render_main.cpp include it; docs/plies.md says what differs
// from the surface model and by how much.
//
// A yarn, that is the union of its plies, is one slab. A ray that meets it enters at the surface of a ply and would
// leave it, straight on, at that of a ply: to either belong a smooth normal n, a fibre tangent t and the slab of
// math.md 3 about n. Light is reflected where the ray enters, into n.i > 0. It is transmitted as often with a bend
// where the ray enters, and leaves where the straight line along i does, as with a bend where the ray leaves: a path
// and its reverse are then the same, with the same n and t at the bend. Light that meets no fibre goes straight on: U,
// the mean of both ends. (A chord of a round section makes the same angle with the normal at both ends; no more than R1
// + T1 + U + diffuse leaves it. Of other sections this holds in the mean over chords, which come in mirrored pairs.)
// Inside a yarn nothing else happens. Each yarn on the way counts, and there is no horizon, height field, footprint or
// estimate of interreflection.
#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include <glm/glm.hpp>

#include "reference/rays_plies.hpp"
#include "reference/scene.hpp"

namespace selvedge
{

// A surface that scatters.
struct PlyVertex {
    std::uint32_t object = 0;
    float distance = 0; // in lengths of the camera ray's direction
    cloth::f32::ClothSurface surface;
    cloth::f32::ClothShading shading;
};

struct PlyCounters {
    std::uint64_t rays = 0, shadow_rays = 0, rays_saved = 0;
};

// The tubes of every object's fabric; none for what is matte.
//   throws  InputError: a repeat too large to resolve
std::vector<PlyModel> ply_models(const Scene& scene);

// The scene must outlive it and not change. Queries may run in any number of threads at once; they allocate nothing.
class PlyScene
{
  public:
    // Whole repeats: as many as the object has, rounded; around a cylinder they close.
    //   models  ply_models of the scene
    //   throws  InputError: a fabric on another shape than plane or cylinder, mirrored or sheared by more than
    //           `stretch_limit`, or more than `instance_limit` repeats
    PlyScene(const Scene& scene, const std::vector<PlyModel>& models);
    ~PlyScene();
    PlyScene(const PlyScene&) = delete;
    PlyScene& operator=(const PlyScene&) = delete;

    // Radiance along a camera ray, over at most max_depth surfaces that scatter.
    //   first  the first of them, where there is one: `hit`
    glm::vec3 radiance(const cloth::f32::ClothRay& ray, cloth::f32::ClothRandom random, int max_depth,
                       PlyCounters& counters, PlyVertex& first, bool& hit) const;

    std::size_t triangles() const { return triangles_; }
    std::size_t instances() const { return instances_.size(); }
    const std::vector<std::string>& warnings() const { return warnings_; }

    static constexpr double stretch_limit = 0.05; // of a repeat along u against along v
    static constexpr double instance_limit = double(1 << 20);

  private:
    struct TubeMesh; // of one fabric object
    struct Placed {  // what an instance is
        std::uint32_t object;
        std::int32_t mesh; // into tubes_; -1: matte
        glm::ivec2 tile;
        glm::mat4x3 to_world;
    };
    struct Inside;
    struct Entry;
    struct Departure;
    bool next_hit(glm::vec3 origin, glm::vec3 direction, const Entry& from, float& near, float far, Entry& hit,
                  bool& entering, std::uint64_t& rays) const;
    bool next(glm::vec3 origin, glm::vec3 direction, const Entry& from, float& near, float far, Inside& inside,
              Entry& entry, std::uint64_t& rays) const;
    bool leaves(glm::vec3 origin, glm::vec3 direction, const Entry& entry, const Inside& before, Entry& exit,
                Departure& at, std::uint64_t& rays) const;
    glm::vec3 position_at(const Entry& entry) const;
    glm::vec3 normal_at(const Entry& entry) const;
    void shade(const Entry& entry, bool leaving, glm::vec3 direction, PlyVertex& vertex) const;
    bool find_vertex(const cloth::f32::ClothRay& ray, cloth::f32::ClothRandom random, Departure& from,
                     PlyCounters& counters, PlyVertex& seen, PlyVertex& vertex) const;
    float transmittance(Departure from, glm::vec3 direction, float far, PlyCounters& counters) const;
    // first: vertex of its path
    glm::vec3 direct_light(const PlyVertex& vertex, const Departure& from, cloth::f32::ClothRandom random, bool first,
                           PlyCounters& counters) const;
    void place_fabric(std::size_t object, const PlyModel& model, std::vector<InstancedMesh>& meshes,
                      std::vector<Instance>& instances);

    const Scene& scene_;
    cloth::f32::ClothLights lights_;
    std::vector<cloth::f32::ClothMaps> maps_; // per object
    std::vector<TubeMesh> tubes_;
    std::vector<Placed> instances_;
    std::unique_ptr<InstancedRays> rays_;
    std::vector<std::string> warnings_;
    std::size_t triangles_ = 0;
};

} // namespace selvedge
