// app/preview/scene_buffers.cpp: a scene packed for the shaders.
#include "app/preview/scene_buffers.hpp"

#include <algorithm>
#include <bit>
#include <cmath>
#include <limits>
#include <stdexcept>

#include "app/preview/block_nodes.hpp"
#include "app/preview/shader_source.hpp"
#include "bake/error.hpp"

namespace selvedge
{

using cloth::f32::ClothCamera;
using cloth::f32::ClothLens;
using cloth::f32::ClothLight;
using cloth::f32::ClothYarn;

template <class T> static std::size_t bytes_of(const std::vector<T>& list)
{
    return list.size() * sizeof(T);
}

static glm::uint word(float x)
{
    return std::bit_cast<glm::uint>(x);
}
static glm::uint word(std::size_t x)
{
    return static_cast<glm::uint>(x);
}

// Positions in buffer textures are 32-bit signed integers in the shader.
static std::size_t checked(std::size_t index)
{
    if (index > std::size_t(std::numeric_limits<int>::max()))
        throw std::runtime_error("the scene is too large: more than 2^31 words in one buffer");
    return index;
}

void SceneBuffers::upload(const Scene& scene, const Needs& needs)
{
    objects.clear();
    std::vector<glm::vec4> triangles;
    std::vector<glm::ivec2> bases;
    for (const SceneObject& source : scene.objects) {
        const Mesh& mesh = source.mesh;
        for (std::size_t t = 0; t < mesh.triangles.size(); ++t) {
            const cloth::f32::ClothTriangle triangle = triangle_of(source, t);
            triangles.insert(triangles.end(), {{triangle.p0, triangle.t0.x},
                                               {triangle.p1, triangle.t0.y},
                                               {triangle.p2, triangle.t1.x},
                                               {triangle.n0, triangle.t1.y},
                                               {triangle.n1, triangle.t2.x},
                                               {triangle.n2, triangle.t2.y}});
        }
        checked(triangles.size());
        if (needs.model.twist_noise) { // otherwise nobody asks which repeat it is
            bases.insert(bases.end(), mesh.tile_base.begin(), mesh.tile_base.end());
            bases.resize(triangles.size() / 6, glm::ivec2(0));
        }
        Object object;
        object.index_count = static_cast<GLsizei>(mesh.triangles.size() * 3);
        object.array = GlName(GlName::Kind::vertex_array);
        object.vertices = GlName(GlName::Kind::buffer);
        object.indices = GlName(GlName::Kind::buffer);
        gl.BindVertexArray(*object.array);
        gl.BindBuffer(GL_ARRAY_BUFFER, *object.vertices);
        gl.BufferData(GL_ARRAY_BUFFER, static_cast<GLsizeiptr>(bytes_of(mesh.positions)), mesh.positions.data(),
                      GL_STATIC_DRAW);
        gl.VertexAttribPointer(0, 3, GL_FLOAT, GL_FALSE, 0, nullptr);
        gl.EnableVertexAttribArray(0);
        gl.BindBuffer(GL_ELEMENT_ARRAY_BUFFER, *object.indices);
        gl.BufferData(GL_ELEMENT_ARRAY_BUFFER, static_cast<GLsizeiptr>(bytes_of(mesh.triangles)), mesh.triangles.data(),
                      GL_STATIC_DRAW);
        objects.push_back(std::move(object));
    }
    gl.BindVertexArray(0);
    check_gl("meshes");
    triangle_table.upload(GL_RGBA32F, 16, triangles.data(), bytes_of(triangles), "triangles", info);
    tile_bases.upload(GL_RG32I, 8, bases.data(), bytes_of(bases), "repeats", info);
    upload_fabrics(scene, needs);
    upload_lights(scene);
}

void SceneBuffers::upload_fabrics(const Scene& scene, const Needs& needs)
{
    struct Place {
        glm::uint texels, horizons, heights, asg, yarns;
        glm::uvec2 mips;
    };
    std::vector<glm::uvec4> maps;
    std::vector<glm::uint> mips;
    std::vector<std::uint16_t> heights;
    std::vector<glm::vec4> asg;
    std::vector<Place> places;
    std::size_t yarns = 0;
    // Only what the model looks at.
    using namespace cloth::f32;
    const bool meso = needs.model.bsdf == cloth_bsdf_meso;
    const bool relief =
        meso && (needs.model.weight == cloth_weight_relief || needs.model.visibility == cloth_visibility_exact);
    const bool slopes = meso && needs.model.weight == cloth_weight_mips;
    const bool shadowed = cloth_uses_visibility(needs.model);
    for (const PackedFabric& fabric : scene.fabrics) {
        Place place{};
        const auto add = [&](const std::vector<glm::uvec2>& front, const std::vector<glm::uvec2>& back) {
            const std::size_t first = maps.size();
            for (std::size_t k = 0; k < front.size(); ++k) maps.emplace_back(front[k], back[k]);
            return word(checked(first));
        };
        place.texels = add(fabric.side[0].texels, fabric.side[1].texels);
        if (shadowed) place.horizons = add(visibility_words(fabric, 0), visibility_words(fabric, 1));
        place.heights = word(checked(heights.size()));
        place.asg = word(checked(asg.size()));
        for (int side = 0; side < 2; ++side) {
            const PackedSide& source = fabric.side[side];
            place.mips[side] = word(checked(mips.size()));
            if (slopes) mips.insert(mips.end(), source.slope_mips.begin(), source.slope_mips.end());
            if (relief) heights.insert(heights.end(), source.heights.begin(), source.heights.end());
            if (shadowed) asg.insert(asg.end(), source.asg.begin(), source.asg.end());
        }
        place.yarns = word(yarns);
        yarns += fabric.yarns.size();
        places.push_back(place);
    }
    map_words.upload(GL_RGBA32UI, 16, maps.data(), bytes_of(maps), "fabric maps", info);
    slope_words.upload(GL_R32UI, 4, mips.data(), bytes_of(mips), "slope maps", info);
    height_words.upload(GL_R16UI, 2, heights.data(), bytes_of(heights), "height maps", info);
    asg_table.upload(GL_RGBA32F, 16, asg.data(), bytes_of(asg), "visibility maps", info);
    upload_yarns(scene);

    std::vector<glm::uvec4> table;
    opaque.clear();
    gauze.clear();
    std::size_t first_triangle = 0;
    for (std::size_t k = 0; k < scene.objects.size(); ++k) {
        const SceneObject& object = scene.objects[k];
        const bool gaps = lets_rays_through(scene, object);
        (gaps && !needs.layers() ? gauze : opaque).push_back(k);
        if (object.fabric < 0) {
            const glm::uvec4 none(0), first(word(first_triangle), 0, 0, word(std::size_t(object.light + 1)));
            const glm::uvec4 colour(word(object.albedo.x), word(object.albedo.y), word(object.albedo.z),
                                    word(object.roughness));
            table.insert(table.end(), {first, none, colour, none, none});
        } else {
            const Place& place = places[std::size_t(object.fabric)];
            const PackedFabric& fabric = scene.fabrics[std::size_t(object.fabric)];
            const glm::uvec2 size(fabric.size), cells(fabric.noise_cells);
            const glm::vec2 front = fabric.side[0].height_range_m, back = fabric.side[1].height_range_m;
            const glm::uint kind = gaps ? 3 : 1;
            table.insert(table.end(), {{word(first_triangle), kind, place.asg, place.yarns},
                                       {size, place.texels, place.horizons},
                                       {place.heights, place.mips, word(fabric.noise_amplitude)},
                                       {word(front.x), word(back.x), word(front.y), word(back.y)},
                                       {word(fabric.tile_m.x), word(fabric.tile_m.y), cells}});
        }
        first_triangle += object.mesh.triangles.size();
    }
    object_table.upload(GL_RGBA32UI, 16, table.data(), bytes_of(table), "objects", info);
    upload_bvh(scene, needs);
}

void SceneBuffers::upload_yarns(const Scene& scene)
{
    std::vector<glm::vec4> table;
    for (const PackedFabric& fabric : scene.fabrics)
        for (const ClothYarn& yarn : fabric.yarns)
            table.insert(table.end(), {{yarn.alpha_t, yarn.thickness, yarn.beneath, yarn.twist.y / (1 + yarn.twist.x)},
                                       {yarn.albedo_r, yarn.alpha_r},
                                       {yarn.albedo_t, yarn.diffuse_mix},
                                       {yarn.diffuse_r, yarn.transmittance.x},
                                       {yarn.diffuse_t, yarn.transmittance.y},
                                       {yarn.reflectance, yarn.transmittance.z},
                                       {yarn.albedo, 0}});
    yarn_table.upload(GL_RGBA32F, 16, table.data(), bytes_of(table), "yarns", info);
}

void SceneBuffers::upload_lights(const Scene& scene)
{
    std::vector<glm::vec4> table;
    for (const ClothLight& light : scene.lights)
        table.insert(table.end(), {{light.position, light.shape.x},
                                   {light.axis, light.shape.y},
                                   {light.radiance, 0},
                                   {light.edge_u, 0},
                                   {light.edge_v, 0},
                                   {static_cast<float>(light.kind), light.pmf, 0, 0}});
    light_table.upload(GL_RGBA32F, 16, table.data(), bytes_of(table), "lights", info);
    std::vector<glm::uvec4> emitters;
    const auto words = [](glm::vec3 v, glm::uint w) { return glm::uvec4(word(v.x), word(v.y), word(v.z), w); };
    for (const cloth::f32::ClothEmitter& part : scene.emitters)
        emitters.insert(emitters.end(),
                        {words(part.p0, part.threshold), words(part.e1, part.other), words(part.e2, 0)});
    emitter_table.upload(GL_RGBA32UI, 16, emitters.data(), bytes_of(emitters), "shining triangles", info);

    const Environment& environment = scene.environment;
    if (std::max(environment.size.x, environment.size.y) > info.texture_limit)
        throw std::runtime_error(format_text("environment of %d x %d texels: %s takes at most %d along a side",
                                             environment.size.x, environment.size.y, info.renderer.c_str(),
                                             info.texture_limit));
    const bool none = environment.size.x == 0;
    const glm::ivec2 size = none ? glm::ivec2(1) : environment.size;
    const glm::vec4 black(0);
    const glm::uvec2 itself(0);
    const auto make = [&](GlName& texture, GLenum format, int height, GLenum channels, GLenum type,
                          const void* texels) {
        if (!texture) texture = GlName(GlName::Kind::texture);
        gl.BindTexture(GL_TEXTURE_2D, *texture);
        gl.PixelStorei(GL_UNPACK_ALIGNMENT, 4);
        gl.TexImage2D(GL_TEXTURE_2D, 0, static_cast<GLint>(format), size.x, height, 0, channels, type, texels);
        for (const GLenum filter : {GL_TEXTURE_MIN_FILTER, GL_TEXTURE_MAG_FILTER})
            gl.TexParameteri(GL_TEXTURE_2D, filter, GL_NEAREST);
    };
    make(environment_map, GL_RGBA32F, size.y, GL_RGBA, GL_FLOAT, none ? &black : environment.texels.data());
    make(inversion_map, GL_RG32UI, none ? 1 : int(environment.inversion.size()) / size.x, GL_RG_INTEGER,
         GL_UNSIGNED_INT, none ? &itself : environment.inversion.data());
    check_gl("environment");
}

void SceneBuffers::upload_bvh(const Scene& scene, const Needs& needs)
{
    static_assert(sizeof(BvhNode) == 32, "two texels a node");
    bvh = needs.traces_rays() ? build_bvh(scene) : Bvh{};
    bvh_eye.reset();
    node_count = static_cast<int>(checked(bvh.nodes.size()));
    bvh_nodes.upload(GL_RGBA32UI, 16, bvh.nodes.data(), bytes_of(bvh.nodes), "BVH nodes", info);
    std::vector<glm::uvec4> table;
    table.reserve(bvh.triangles.size() * 3);
    const auto words = [](glm::vec3 v, glm::uint w) { return glm::uvec4(word(v.x), word(v.y), word(v.z), w); };
    for (const glm::uvec2& which : bvh.triangles) {
        const SceneObject& object = scene.objects[which.x];
        const glm::uvec3& corner = object.mesh.triangles[which.y];
        const glm::vec3 p0 = object.mesh.positions[corner.x];
        table.insert(table.end(),
                     {words(p0, which.x), words(object.mesh.positions[corner.y] - p0, which.y),
                      words(object.mesh.positions[corner.z] - p0, lets_rays_through(scene, object) ? 1 : 0)});
    }
    bvh_triangles.upload(GL_RGBA32UI, 16, table.data(), bytes_of(table), "BVH triangles", info);
    bvh.triangles = {};
}

void SceneBuffers::order_bvh(glm::vec3 eye, bool once)
{
    if (bvh_eye && (once || *bvh_eye == eye)) return;
    selvedge::order_bvh(bvh, eye);
    bvh_eye = eye;
    bvh_nodes.upload(GL_RGBA32UI, 16, bvh.nodes.data(), bytes_of(bvh.nodes), "BVH nodes", info);
}

std::vector<bool> SceneBuffers::upload_blocks(glm::ivec2 resolution)
{
    const glm::ivec2 count = blocks_of(resolution);
    const std::vector<glm::ivec2> ranges(std::size_t(count.x) * std::size_t(count.y), glm::ivec2(0, node_count));
    block_nodes.upload(GL_RG32I, 8, ranges.data(), bytes_of(ranges), "blocks of pixels", info);
    return std::vector<bool>(ranges.size(), true);
}

std::vector<bool> SceneBuffers::upload_blocks(const ClothCamera& camera, const ClothLens& lens, int filter)
{
    const std::size_t texels = static_cast<std::size_t>(info.buffer_texture_limit);
    const BlockTrees trees = block_trees(bvh.nodes, camera, lens, filter, texels / 2);
    bvh_nodes.upload(GL_RGBA32UI, 16, trees.nodes.data(), bytes_of(trees.nodes), "BVH nodes", info);
    block_nodes.upload(GL_RG32I, 8, trees.ranges.data(), bytes_of(trees.ranges), "blocks of pixels", info);
    std::vector<bool> any(trees.ranges.size());
    std::transform(trees.ranges.begin(), trees.ranges.end(), any.begin(),
                   [](glm::ivec2 range) { return range.x < range.y; });
    return any;
}

void SceneBuffers::bind_textures() const
{
    const auto bind = [](const char* name, GLenum target, GLuint texture) {
        gl.ActiveTexture(GL_TEXTURE0 + static_cast<GLenum>(texture_unit(name)));
        gl.BindTexture(target, texture);
    };
    const std::pair<const char*, const BufferTexture*> tables[] = {
        {"map_words", &map_words},         {"slope_words", &slope_words},       {"yarn_table", &yarn_table},
        {"height_words", &height_words},   {"asg_table", &asg_table},           {"tile_base_table", &tile_bases},
        {"light_table", &light_table},     {"triangle_table", &triangle_table}, {"object_table", &object_table},
        {"emitter_table", &emitter_table}, {"bvh_nodes", &bvh_nodes},           {"bvh_triangles", &bvh_triangles},
        {"block_nodes", &block_nodes}};
    for (const auto& [name, table] : tables) bind(name, GL_TEXTURE_BUFFER, table->texture());
    bind("environment_map", GL_TEXTURE_2D, *environment_map);
    bind("inversion_map", GL_TEXTURE_2D, *inversion_map);
    gl.ActiveTexture(GL_TEXTURE0);
}

void SceneBuffers::bind_object(std::size_t index) const
{
    gl.BindVertexArray(*objects[index].array);
}

std::size_t SceneBuffers::bytes() const
{
    std::size_t total = 0;
    for (const BufferTexture* table :
         {&map_words, &slope_words, &height_words, &asg_table, &tile_bases, &yarn_table, &light_table, &triangle_table,
          &object_table, &emitter_table, &bvh_nodes, &bvh_triangles, &block_nodes})
        total += table->bytes();
    return total;
}

// ---- the near plane ----------------------------------------------------------------------------------------------

// Squared distance from p to a triangle (Ericson 2005, "Real-Time Collision Detection", 5.1.5).
static double distance2_to_triangle(glm::dvec3 p, glm::dvec3 a, glm::dvec3 b, glm::dvec3 c)
{
    const auto dist2 = [&](glm::dvec3 q) { return glm::dot(p - q, p - q); };
    const glm::dvec3 ab = b - a, ac = c - a, ap = p - a, bp = p - b, cp = p - c;
    const double d1 = glm::dot(ab, ap), d2 = glm::dot(ac, ap);
    if (d1 <= 0 && d2 <= 0) return dist2(a);
    const double d3 = glm::dot(ab, bp), d4 = glm::dot(ac, bp);
    if (d3 >= 0 && d4 <= d3) return dist2(b);
    const double vc = d1 * d4 - d3 * d2;
    if (vc <= 0 && d1 >= 0 && d3 <= 0) return dist2(a + ab * (d1 / (d1 - d3)));
    const double d5 = glm::dot(ab, cp), d6 = glm::dot(ac, cp);
    if (d6 >= 0 && d5 <= d6) return dist2(c);
    const double vb = d5 * d2 - d1 * d6;
    if (vb <= 0 && d2 >= 0 && d6 <= 0) return dist2(a + ac * (d2 / (d2 - d6)));
    const double va = d3 * d6 - d5 * d4;
    if (va <= 0 && d4 - d3 >= 0 && d5 - d6 >= 0) return dist2(b + (c - b) * ((d4 - d3) / ((d4 - d3) + (d5 - d6))));
    const double total = va + vb + vc;
    return dist2(a + ab * (vb / total) + ac * (vc / total));
}

float SceneBuffers::nearest_distance(const Scene& scene, glm::vec3 point)
{
    double best = std::numeric_limits<double>::max();
    for (const SceneObject& object : scene.objects) {
        glm::vec3 low(std::numeric_limits<float>::max()), high(-std::numeric_limits<float>::max());
        for (const glm::vec3& position : object.mesh.positions) {
            low = glm::min(low, position);
            high = glm::max(high, position);
        }
        const glm::dvec3 outside = glm::max(glm::dvec3(0), glm::dvec3(glm::max(low - point, point - high)));
        if (glm::dot(outside, outside) >= best) continue;
        for (const glm::uvec3& t : object.mesh.triangles) {
            const double d = distance2_to_triangle(point, object.mesh.positions[t.x], object.mesh.positions[t.y],
                                                   object.mesh.positions[t.z]);
            if (d < best) best = d; // a triangle without area gives NaN, which is not less
        }
    }
    return static_cast<float>(std::sqrt(std::min(best, 1e30)));
}

} // namespace selvedge
