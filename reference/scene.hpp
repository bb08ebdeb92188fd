// A scene in memory: camera, film, lights, environment, objects in world space, baked fabrics. Both renderers read it;
// neither changes it. The loader (scene.cpp) is the only code that reads scene files.
#pragma once
#include "bake/bake.hpp"
#include "bake/pack.hpp"
#include "glsl/cloth_bsdf.hpp"
#include "reference/model.hpp"
#include <filesystem>
#include <glm/glm.hpp>
#include <string>
#include <utility>
#include <vector>

namespace selvedge
{

// Triangles in world space [m]. Per-corner UV is in tiles of the object's fabric, less `tile_base` of its triangle, so
// that float keeps its digits at any number of repeats (math.md 10, hazard 16). Matte objects have UV 0.
struct Mesh {
    std::vector<glm::vec3> positions;    // per vertex
    std::vector<glm::vec3> normals;      // per vertex, unit
    std::vector<glm::uvec3> triangles;   // vertex indices, counter-clockwise seen from the front
    std::vector<glm::vec2> corner_tiles; // 3 per triangle
    std::vector<glm::ivec2> tile_base;   // 1 per triangle
};

struct SceneObject {
    std::string name; // "objects.3 (drape)"; for messages and lists
    Mesh mesh;
    int fabric = -1;          // index into Scene::fabrics; -1: matte or metal
    glm::vec3 albedo{0.18f};  // matte; of metal the reflectance at normal incidence
    float roughness = 0.0f;   // of metal: alpha of GGX; 0: matte
    glm::vec3 emission{0.0f}; // radiance of the front, as the file says; in `lights` if there is any
    int light = -1;           // index into Scene::lights; -1: does not shine
    // How the mesh came about, for who puts other geometry in its place (plies.hpp).
    std::string shape; // built-in shape, or empty
    glm::dmat4 to_world{1.0};
    glm::dmat2 tiles_from_uv{0.0}; // from UV to repeats of the fabric
};

struct Environment {
    glm::ivec2 size{0, 0};         // 0: the scene has none
    std::vector<glm::vec4> texels; // rgb radiance, w density over UV (mean 1), as cloth_fetch_environment wants them
    std::vector<glm::uvec2> inversion; // inversion_table
};

// What the camera was made from; the window's orbit edits this and calls make_camera.
struct CameraSpec {
    glm::vec3 position{0.0f, 1.0f, 3.0f}, target{0.0f}, up{0.0f, 1.0f, 0.0f};
    float fov_degrees = 35.0f; // vertical
    float lens_radius = 0.0f;  // [m]; 0: a pinhole
    float focus_m = 0.0f;      // distance of the plane in focus along the view; 0: that of the target
};

struct FilmSpec {
    glm::ivec2 resolution{512, 512};
    int filter = cloth::f32::cloth_filter_box;
    float exposure = 0.0f; // stops, display only
};

struct Scene {
    CameraSpec camera;
    FilmSpec film;
    std::vector<cloth::f32::ClothLight> lights; // the environment, where there is one, is light 0; pmf adds up to 1
    Environment environment;
    std::vector<cloth::f32::ClothEmitter> emitters; // triangles of the lights that are objects
    std::vector<SceneObject> objects;
    std::vector<PackedFabric> fabrics;
    std::vector<Fabric> fabric_sources; // what each was baked from: for live edits (shade_yarns, bake_fabric)
    std::vector<std::filesystem::path> fabric_paths; // empty for a fabric written inside the scene
    int black_lights = 0;                            // lights of the file that shine nothing: not in `lights`
    ModelSpec model = model_preset("ours");
    std::string hash; // 16 hex digits, of everything that decides a pixel but for `settings`
    std::vector<std::string> warnings;
    double seconds_load = 0.0, seconds_bake = 0.0;
};

// Reads a scene file and everything it names, bakes its fabrics (or takes them from the cache). Transforms: scale, then
// rotation about the fixed x, y and z axes in this order, then translation.
//   overrides  "path.to.key=value"; "objects.N.fabric.KEY=value" reaches into the fabric file that object N names,
//              "fabric.KEY=value" into every fabric
//   throws     InputError with file, line and key; UsageError for an override that names nothing
Scene load_scene(const std::filesystem::path& path, const Overrides& overrides = {});

cloth::f32::ClothCamera make_camera(const CameraSpec& camera, glm::ivec2 resolution);
cloth::f32::ClothLens lens_of(const CameraSpec& camera);
cloth::f32::ClothLights lights_of(const Scene& scene);
cloth::f32::ClothTriangle triangle_of(const SceneObject& object, std::size_t triangle);

// Turns a part of the scene about the vertical through the camera's target, counter-clockwise seen from above.
// `objects`: those that do not shine; `lights`: the environment, the lights of the list and the objects that shine.
enum class Turned { objects, camera, lights };
void turn_scene(Scene& scene, Turned what, double degrees);

// Fills `emitters` and the geometry of the lights that are objects, anew after objects have moved.
void place_emitters(Scene& scene);

// Whether a ray may pass through the object: through gaps, or between the fibres of its yarns where the model has that.
bool lets_rays_through(const Scene& scene, const SceneObject& object);

} // namespace selvedge
