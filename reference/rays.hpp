// Rays against the scene's triangles: closest hits, shadow rays that pass through gaps, and a BVH for the preview's
// shader. The integrator and the preview include it; rays.cpp is the only file that includes Embree.
#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include <glm/glm.hpp>

#include "reference/scene.hpp"

namespace selvedge
{

struct RayHit {
    bool any = false;
    std::uint32_t object = 0, triangle = 0;
    float distance = 0.0f; // in lengths of the direction, which need not be unit
};

struct PencilRay {
    glm::vec3 origin, direction;
    float near;
};

struct ShadowRay {
    glm::vec3 origin, direction;
    float far;                    // in lengths of the direction
    float least;                  // of its roulette: cloth_shadow_roulette; 0: it has none
    cloth::f32::ClothShare share; // before: what it sets out with; answer: what arrives
};

// A sheet of cloth that a shadow ray has crossed, until it is known what it lets through.
struct CrossedSheet {
    std::uint32_t ray, object, triangle;
    float u, v;
    glm::vec2 tile;
    glm::vec3 direction; // local
};

// What the scene did not need.
struct RayNeeds {
    std::size_t triangles = 0;
    int objects = 0, filtered_objects = 0; // filtered: with gaps that a shadow ray has to look at
};

// The scene must outlive it and not change. Queries may run in any number of threads at once; they allocate nothing but
// room for `sheets`.
class RayScene
{
  public:
    explicit RayScene(const Scene& scene);
    ~RayScene();
    RayScene(const RayScene&) = delete;
    RayScene& operator=(const RayScene&) = delete;

    // First triangle with distance in [near, far], in lengths of `direction`.
    RayHit closest(glm::vec3 origin, glm::vec3 direction, float near, float far) const;
    // The same bits, from `near` to infinity, of rays that go nearly the same way. Only where two objects have the very
    // same surface may it be the other one that is met.
    void closest_together(const PencilRay* rays, std::uint32_t count, RayHit* hits) const;
    // Share of the light that arrives: 0 behind matte, times cloth_transmittance for every sheet of cloth in the way.
    // Of many rays at once, so that what the maps say of one sheet is on its way while others are looked at. With a
    // roulette the way may be over at any sheet: all go as far as their first one, those that pass it on by themselves.
    //   together  so many of them, the first, go nearly the same way, without roulette; the answers' bits do not depend
    //             on it
    //   sheets    room to work in, kept from call to call by those who have many
    void find_transmittances(ShadowRay* rays, std::uint32_t together, std::uint32_t count,
                             const cloth::f32::ClothSettings& settings, std::vector<CrossedSheet>& sheets) const;
    float transmittance(glm::vec3 origin, glm::vec3 direction, float far,
                        const cloth::f32::ClothSettings& settings) const;

    const RayNeeds& needs() const { return needs_; }

  private:
    struct State;
    std::unique_ptr<State> state_;
    RayNeeds needs_;
};

// One node of a binary BVH in depth-first order, to be walked without a stack: from node n go to n + 1 where the box is
// hit, to `skip` where it is missed or after a leaf; the walk ends at nodes.size().
struct BvhNode {
    glm::vec3 low;
    std::uint32_t skip;
    glm::vec3 high;
    std::uint32_t leaf; // 0: inner node; else first triangle * 8 + count, count in 1..7 (first indexes Bvh::triangles)
};

struct Bvh {
    std::vector<BvhNode> nodes;        // empty for a scene without triangles
    std::vector<glm::uvec2> triangles; // (object, triangle) in the order of the leaves
};

// Surface area heuristic at high quality, leaves of at most four triangles: for any-hit rays in the preview's shader.
//   throws  InputError for more than 2^29 triangles
Bvh build_bvh(const Scene& scene);

// The same tree with the child first that lies nearer to `eye`: rays from there that look for the nearest triangle then
// leave out most of what lies behind it.
void order_bvh(Bvh& bvh, glm::vec3 eye);

std::string embree_version(); // "3.13.5"

} // namespace selvedge
