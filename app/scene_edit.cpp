// app/scene_edit.cpp: edits of fabrics.
#include "app/scene_edit.hpp"

#include <cmath>

namespace selvedge
{

bool shade_again(Scene& scene, std::size_t fabric)
{
    const Fabric& source = scene.fabric_sources[fabric];
    PackedFabric& packed = scene.fabrics[fabric];
    if (yarn_types(source).types.size() != packed.yarn_names.size()) return false;
    packed.yarns = shade_yarns(source, packed.stacks, scene.model.stacked);
    return true;
}

static void retile(Mesh& mesh, glm::dvec2 factor)
{
    for (std::size_t t = 0; t < mesh.triangles.size(); ++t) {
        glm::dvec2 corner[3];
        for (std::size_t k = 0; k < 3; ++k)
            corner[k] = (glm::dvec2(mesh.corner_tiles[3 * t + k]) + glm::dvec2(mesh.tile_base[t])) * factor;
        const glm::dvec2 base = glm::floor(glm::min(corner[0], glm::min(corner[1], corner[2])));
        mesh.tile_base[t] = glm::ivec2(base);
        for (std::size_t k = 0; k < 3; ++k) mesh.corner_tiles[3 * t + k] = corner[k] - base;
    }
}

void bake_again(Scene& scene, std::size_t fabric)
{
    BakeOptions options;
    options.visibility = scene.model.visibility;
    options.stacked = scene.model.stacked;
    PackedFabric baked = bake_fabric(scene.fabric_sources[fabric], options);
    const glm::dvec2 factor = glm::dvec2(scene.fabrics[fabric].tile_m) / glm::dvec2(baked.tile_m);
    scene.fabrics[fabric] = std::move(baked);
    if (factor == glm::dvec2(1)) return;
    for (SceneObject& object : scene.objects)
        if (object.fabric == static_cast<int>(fabric)) retile(object.mesh, factor);
}

} // namespace selvedge
