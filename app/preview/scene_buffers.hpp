// app/preview/scene_buffers.hpp: a scene as the shaders read it: buffer textures, environment, vertex arrays. The
// layouts are those of glsl/cloth_fetch.h, glsl/scene_buffers.h and glsl/trace.h. Included by app/preview/preview.cpp.
#pragma once

#include <cstdint>
#include <optional>
#include <vector>

#include "gl.hpp"
#include "needs.hpp"
#include "reference/rays.hpp"
#include "reference/scene.hpp"

namespace selvedge
{

// Parts that change on their own are uploaded on their own. Scenes are not kept: every call is given the one to read,
// and what is needed of it: what is not needed is not uploaded.
class SceneBuffers
{
  public:
    explicit SceneBuffers(const GlInfo& of_driver) : info(of_driver) {}

    // throws std::runtime_error where the scene exceeds a limit of the driver, naming both
    void upload(const Scene& scene, const Needs& needs);         // everything
    void upload_yarns(const Scene& scene);                       // same count as before
    void upload_fabrics(const Scene& scene, const Needs& needs); // maps, yarns, and the objects' references to them
    void upload_lights(const Scene& scene);                      // lights and environment
    void upload_bvh(const Scene& scene, const Needs& needs);     // what rays walk
    // For rays from there; nothing where it is so, or where `once` and it was ordered for another eye. Shadow rays gain
    // by it as well.
    void order_bvh(glm::vec3 eye, bool once);
    // Of the BVH as it is now, what a view's blocks of pixels may meet: all of it, or what they see (block_nodes.hpp).
    //   return  of each block, whether there is anything
    std::vector<bool> upload_blocks(glm::ivec2 resolution);
    std::vector<bool> upload_blocks(const cloth::f32::ClothCamera& camera, const cloth::f32::ClothLens& lens,
                                    int filter);

    void bind_textures() const;
    void bind_object(std::size_t index) const; // vertex array of an object
    GLsizei index_count(std::size_t index) const { return objects[index].index_count; }
    std::size_t bytes() const;

    std::vector<std::size_t> opaque, gauze; // objects by whether the visibility pass lets rays through
    int node_count = 0;                     // of the BVH

    // Distance from a point to the nearest triangle [m]; large where there is none.
    static float nearest_distance(const Scene& scene, glm::vec3 point);

  private:
    struct Object {
        GlName vertices, indices, array;
        GLsizei index_count = 0;
    };

    GlInfo info;
    std::vector<Object> objects;
    BufferTexture map_words, slope_words, height_words, asg_table, tile_bases, yarn_table, light_table, triangle_table,
        object_table, emitter_table, bvh_nodes, bvh_triangles, block_nodes;
    GlName environment_map, inversion_map;
    Bvh bvh; // without the triangles
    std::optional<glm::vec3> bvh_eye;
};

} // namespace selvedge
