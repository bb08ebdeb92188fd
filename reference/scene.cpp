// The scene loader: JSON in, everything that both renderers read out.
#include "reference/scene.hpp"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstring>
#include <map>
#include <numbers>

#include <glm/gtc/matrix_transform.hpp>

#include "bake/error.hpp"
#include "bake/fabric.hpp"
#include "bake/json.hpp"
#include "reference/environment.hpp"
#include "reference/mesh.hpp"

namespace selvedge
{

namespace
{

namespace f32 = cloth::f32;
using Clock = std::chrono::steady_clock;

constexpr double far_limit = 1e7;     // positions [m]
constexpr double bright_limit = 1e12; // radiance, irradiance, intensity
constexpr int resolution_limit = 16384;
constexpr double radians_per_degree = std::numbers::pi / 180.0;

double seconds_since(Clock::time_point start)
{
    return std::chrono::duration<double>(Clock::now() - start).count();
}

double luminance(glm::vec3 colour)
{
    return 0.2126 * double(colour.x) + 0.7152 * double(colour.y) + 0.0722 * double(colour.z);
}

// ---- overrides
// ---------------------------------------------------------------------------------------------------------

// -D settings sorted by the file that they change.
struct SortedOverrides {
    Overrides scene;
    std::map<std::size_t, Overrides> fabric_of; // object index -> overrides of its fabric file
};

// "objects.3.fabric.warp.width=1" -> (3, "warp.width=1"); false for anything else.
bool names_fabric_key(const std::string& text, std::size_t& object, std::string& rest)
{
    const std::string path = text.substr(0, text.find('='));
    if (path.rfind("objects.", 0) != 0) return false;
    const std::size_t dot = path.find('.', 8);
    if (dot == std::string::npos || dot == 8 || dot > 8 + 6) return false;
    const std::string digits = path.substr(8, dot - 8);
    if (digits.find_first_not_of("0123456789") != std::string::npos) return false;
    const std::string key = ".fabric.";
    if (path.compare(dot, key.size(), key) != 0) return false;
    object = std::stoul(digits);
    rest = text.substr(dot + key.size());
    return true;
}

SortedOverrides sort_overrides(const JsonValue& root, const Overrides& overrides)
{
    const auto fabric_at = [&](std::size_t object) -> const nlohmann::json* {
        const nlohmann::json& scene = root.raw();
        if (!scene.is_object() || !scene.contains("objects") || !scene["objects"].is_array()) return nullptr;
        if (object >= scene["objects"].size() || !scene["objects"][object].is_object()) return nullptr;
        const nlohmann::json& entry = scene["objects"][object];
        return entry.contains("fabric") ? &entry["fabric"] : nullptr;
    };
    const std::size_t objects =
        root.raw().is_object() && root.raw().contains("objects") ? root.raw()["objects"].size() : 0;
    SortedOverrides sorted;
    const auto place = [&](std::size_t object, const std::string& rest) {
        const nlohmann::json* fabric = fabric_at(object);
        if (fabric && fabric->is_string())
            sorted.fabric_of[object].push_back(rest);
        else
            sorted.scene.push_back("objects." + std::to_string(object) + ".fabric." + rest);
    };
    for (const std::string& text : overrides) {
        std::size_t object = 0;
        std::string rest;
        if (names_fabric_key(text, object, rest)) {
            place(object, rest);
        } else if (text.rfind("fabric.", 0) == 0) {
            bool any = false;
            for (std::size_t k = 0; k < objects; ++k)
                if (fabric_at(k)) place(k, text.substr(7)), any = true;
            if (!any) throw UsageError("-D %s: the scene has no fabric", text.c_str());
        } else {
            sorted.scene.push_back(text);
        }
    }
    return sorted;
}

// ---- lights
// ------------------------------------------------------------------------------------------------------------

f32::ClothLight blank_light(int kind)
{
    f32::ClothLight light{};
    light.kind = kind;
    light.pmf = 1.0f;
    light.position = glm::vec3(0.0f);
    light.axis = glm::vec3(0.0f, -1.0f, 0.0f);
    light.radiance = glm::vec3(0.0f);
    light.edge_u = light.edge_v = glm::vec3(0.0f);
    light.shape = glm::vec2(0.0f);
    return light;
}

glm::vec3 unit_vector(const JsonValue& value)
{
    const glm::dvec3 v = value.vector3(-far_limit, far_limit);
    const double length = glm::length(v);
    if (!(length > 1e-12)) value.fail("found a vector of length 0, expected a direction");
    return glm::vec3(v / length);
}

// Position and aim of a light that has a place.
void read_aim(f32::ClothLight& light, const JsonValue& value)
{
    light.position = value["position"].vector3(-far_limit, far_limit);
    const glm::dvec3 aim = glm::dvec3(value["target"].vector3(-far_limit, far_limit)) - glm::dvec3(light.position);
    if (!(glm::length(aim) > 1e-12)) value["target"].fail("found the light's own position, expected another point");
    light.axis = glm::vec3(glm::normalize(aim));
}

f32::ClothLight read_environment(const JsonValue& value, Scene& scene)
{
    value.expect_object({"type", "image", "rotation", "scale", "colour", "visible"});
    if (scene.environment.size.x > 0) value.fail("found a second environment, expected at most one");
    f32::ClothLight light = blank_light(f32::cloth_light_environment);
    light.radiance = value.has("scale") ? value["scale"].number_or_vector3(0.0, bright_limit) : glm::vec3(1.0f);
    // cloth_environment turns from -z toward +x, which is clockwise about +y; objects turn the other way.
    light.shape.x = -float(value.number("rotation", 0.0, -36000.0, 36000.0) * radians_per_degree);
    light.shape.y = value.boolean("visible", true) ? 0.0f : 1.0f; // cloth_background: above 0 hides it
    if (value.has("image")) {
        if (value.has("colour")) value["colour"].fail("found both \"image\" and \"colour\", expected one of them");
        scene.environment = load_environment(value["image"].file(), scene.warnings);
    } else {
        const glm::vec3 colour =
            value.has("colour") ? value["colour"].number_or_vector3(0.0, bright_limit) : glm::vec3(1.0f);
        scene.environment = constant_environment(colour);
    }
    return light;
}

// A rectangle that is seen: an object of two triangles that face the way the light shines.
SceneObject shining_rectangle(const f32::ClothLight& light, const std::string& name)
{
    SceneObject object;
    object.name = name;
    object.albedo = glm::vec3(0.0f);
    object.emission = light.radiance;
    for (const glm::vec2 corner : {glm::vec2(-1, -1), glm::vec2(-1, 1), glm::vec2(1, 1), glm::vec2(1, -1)}) {
        object.mesh.positions.push_back(light.position + light.edge_u * corner.x + light.edge_v * corner.y);
        object.mesh.normals.push_back(light.axis);
    }
    object.mesh.triangles = {{0, 1, 2}, {0, 2, 3}};
    object.mesh.corner_tiles.assign(6, glm::vec2(0.0f));
    object.mesh.tile_base.assign(2, glm::ivec2(0));
    return object;
}

f32::ClothLight read_light(const JsonValue& value, Scene& scene)
{
    const std::string type = value["type"].choice({"environment", "directional", "point", "spot", "area", "flash"});
    if (type == "environment") return read_environment(value, scene);
    if (type == "directional") {
        value.expect_object({"type", "direction", "irradiance", "angular_diameter"});
        f32::ClothLight light = blank_light(f32::cloth_light_directional);
        light.axis = -unit_vector(value["direction"]);
        light.radiance = value["irradiance"].number_or_vector3(0.0, bright_limit);
        const double half = 0.5 * value.number("angular_diameter", 0.53, 0.0, 180.0) * radians_per_degree;
        light.shape.x = float(2.0 * std::sin(0.5 * half) * std::sin(0.5 * half));
        return light;
    }
    if (type == "point") {
        value.expect_object({"type", "position", "intensity"});
        f32::ClothLight light = blank_light(f32::cloth_light_point);
        light.position = value["position"].vector3(-far_limit, far_limit);
        light.radiance = value["intensity"].number_or_vector3(0.0, bright_limit);
        return light;
    }
    if (type == "spot") {
        value.expect_object({"type", "position", "target", "intensity", "cone", "penumbra"});
        f32::ClothLight light = blank_light(f32::cloth_light_spot);
        read_aim(light, value);
        light.radiance = value["intensity"].number_or_vector3(0.0, bright_limit);
        const double cone = value.number("cone", 30.0, 0.01, 180.0);
        const double penumbra = value.number("penumbra", 0.1 * cone, 0.0, cone);
        light.shape = {float(std::cos(cone * radians_per_degree)),
                       float(std::cos((cone - penumbra) * radians_per_degree))};
        return light;
    }
    if (type == "area") {
        value.expect_object({"type", "position", "target", "size", "radiance", "visible"});
        f32::ClothLight light = blank_light(f32::cloth_light_area);
        read_aim(light, value);
        light.radiance = value["radiance"].number_or_vector3(0.0, bright_limit);
        const glm::dvec2 size = value["size"].number_or_vector2(1e-6, far_limit);
        const glm::dvec3 axis = light.axis;
        const glm::dvec3 up = std::abs(axis.y) < 0.999 ? glm::dvec3(0.0, 1.0, 0.0) : glm::dvec3(0.0, 0.0, -1.0);
        const glm::dvec3 u = glm::normalize(glm::cross(axis, up));
        light.edge_u = glm::vec3(u * (0.5 * size.x));
        light.edge_v = glm::vec3(glm::cross(u, axis) * (0.5 * size.y));
        return light;
    }
    value.expect_object({"type", "position", "target", "intensity"});
    f32::ClothLight light = blank_light(f32::cloth_light_flash);
    read_aim(light, value);
    light.radiance = value["intensity"].number_or_vector3(0.0, bright_limit);
    return light;
}

// Irradiance that a light may bring to the middle of the scene, without regard to what is in its way.
double expected_irradiance(const f32::ClothLight& light, const Environment& environment, glm::dvec3 centre,
                           double radius)
{
    const double l = luminance(light.radiance);
    if (light.kind == f32::cloth_light_environment) return std::numbers::pi * mean_luminance(environment) * l;
    if (light.kind == f32::cloth_light_directional) return l;
    const glm::dvec3 to = centre - glm::dvec3(light.position);
    const double distance2 = std::max(glm::dot(to, to), 0.25 * radius * radius + 1e-12);
    if (light.kind == f32::cloth_light_mesh) return l * 0.5 * double(light.edge_u.x) / distance2;
    if (light.kind == f32::cloth_light_area)
        return l * 4.0 * glm::length(glm::cross(glm::dvec3(light.edge_u), glm::dvec3(light.edge_v))) / distance2;
    return l / distance2;
}

// Lights are chosen in proportion to what they may bring to the middle of the cloth, a quarter of the choices evenly,
// so that a light that is near some far corner is not starved.
void choose_probabilities(Scene& scene)
{
    glm::dvec3 low(std::numeric_limits<double>::max()), high(-std::numeric_limits<double>::max());
    const bool cloth =
        std::any_of(scene.objects.begin(), scene.objects.end(), [](const SceneObject& o) { return o.fabric >= 0; });
    for (const SceneObject& object : scene.objects)
        if (object.fabric >= 0 || (!cloth && object.light < 0))
            for (const glm::vec3& p : object.mesh.positions)
                low = glm::min(low, glm::dvec3(p)), high = glm::max(high, glm::dvec3(p));
    if (!(low.x <= high.x)) low = high = glm::dvec3(0.0);
    const glm::dvec3 centre = 0.5 * (low + high);
    const double radius = 0.5 * glm::length(high - low);
    std::vector<double> share;
    double total = 0.0;
    for (const f32::ClothLight& light : scene.lights) {
        share.push_back(expected_irradiance(light, scene.environment, centre, radius));
        total += share.back();
    }
    for (std::size_t k = 0; k < scene.lights.size(); ++k)
        scene.lights[k].pmf = float(0.25 / double(scene.lights.size()) + 0.75 * share[k] / total);
}

void read_lights(const JsonValue& value, Scene& scene)
{
    if (!value.is_array()) value.fail("found something else, expected a list of lights");
    for (const JsonValue& entry : value.elements()) {
        const f32::ClothLight light = read_light(entry, scene);
        bool shines = luminance(light.radiance) > 0.0;
        const bool environment = light.kind == f32::cloth_light_environment;
        if (environment) shines = shines && mean_luminance(scene.environment) > 0.0;
        if (!shines) {
            ++scene.black_lights;
            if (environment) scene.environment = {};
            continue;
        }
        if (light.kind == f32::cloth_light_area && entry.boolean("visible", false)) {
            scene.objects.push_back(shining_rectangle(light, entry.key() + " (area)"));
            continue;
        }
        scene.lights.insert(environment ? scene.lights.begin() : scene.lights.end(), light);
    }
}

// Objects that shine become lights, after those of the list.
void add_shining_objects(Scene& scene)
{
    for (SceneObject& object : scene.objects) {
        if (!(luminance(object.emission) > 0.0)) continue;
        object.light = int(scene.lights.size());
        f32::ClothLight light = blank_light(f32::cloth_light_mesh);
        light.radiance = object.emission;
        scene.lights.push_back(light);
    }
    place_emitters(scene);
}

// ---- camera, film, objects
// -------------------------------------------------------------------------------------------------

CameraSpec read_camera(const JsonValue& value)
{
    value.expect_object(
        {"position", "target", "up", "fov", "lens_radius", "f_number", "sensor_height", "focus_distance"});
    CameraSpec camera;
    camera.position = value.vector3("position", camera.position, -far_limit, far_limit);
    camera.target = value.vector3("target", camera.target, -far_limit, far_limit);
    camera.up = value.vector3("up", camera.up, -far_limit, far_limit);
    camera.fov_degrees = float(value.number("fov", double(camera.fov_degrees), 0.01, 175.0));
    const glm::dvec3 forward = glm::dvec3(camera.target) - glm::dvec3(camera.position);
    if (!(glm::length(forward) > 1e-9)) value.fail("found a camera that stands on its target, expected two points");
    const glm::dvec3 side = glm::cross(forward, glm::dvec3(camera.up));
    if (!(glm::length(side) > 1e-6 * glm::length(forward) * glm::length(glm::dvec3(camera.up))))
        value.fail("found \"up\" along the view or of length 0, expected another direction");
    camera.lens_radius = float(value.number("lens_radius", 0.0, 0.0, 1e3));
    if (value.has("f_number")) {
        if (value.has("lens_radius")) value["f_number"].fail("found both \"f_number\" and \"lens_radius\"");
        // Focal length of a lens whose image, at the field of view, fills the sensor from far away.
        const double focal = 0.5 * value.number("sensor_height", 0.024, 1e-5, 10.0) /
                             std::tan(0.5 * double(camera.fov_degrees) * radians_per_degree);
        camera.lens_radius = float(0.5 * focal / value["f_number"].number(0.1, 1e6));
    } else if (value.has("sensor_height")) {
        value["sensor_height"].fail("found no \"f_number\" beside it, which alone needs it");
    }
    camera.focus_m = float(value.number("focus_distance", 0.0, 0.0, far_limit));
    return camera;
}

FilmSpec read_film(const JsonValue& value)
{
    value.expect_object({"resolution", "filter", "exposure"});
    FilmSpec film;
    if (value.has("resolution")) {
        const JsonValue list = value["resolution"];
        if (!list.is_array() || list.raw().size() != 2)
            list.fail("found something else, expected [width, height] in pixels");
        film.resolution = {list[std::size_t(0)].integer(1, resolution_limit),
                           list[std::size_t(1)].integer(1, resolution_limit)};
    }
    if (value.has("filter"))
        film.filter =
            value["filter"].choice({"box", "tent"}) == "tent" ? f32::cloth_filter_tent : f32::cloth_filter_box;
    film.exposure = float(value.number("exposure", 0.0, -40.0, 40.0));
    return film;
}

glm::dmat4 read_transform(const JsonValue& value)
{
    const glm::dvec3 translate = value.vector3("translate", glm::vec3(0.0f), -far_limit, far_limit);
    const glm::dvec3 rotate =
        glm::dvec3(value.vector3("rotate", glm::vec3(0.0f), -36000.0, 36000.0)) * radians_per_degree;
    const glm::dvec3 scale = value.has("scale") ? value["scale"].number_or_vector3(-1e6, 1e6) : glm::vec3(1.0f);
    if (std::abs(scale.x * scale.y * scale.z) < 1e-30)
        value["scale"].fail("found a scale of 0, expected other numbers");
    glm::dmat4 m = glm::translate(glm::dmat4(1.0), translate);
    m = glm::rotate(m, rotate.z, glm::dvec3(0.0, 0.0, 1.0));
    m = glm::rotate(m, rotate.y, glm::dvec3(0.0, 1.0, 0.0));
    m = glm::rotate(m, rotate.x, glm::dvec3(1.0, 0.0, 0.0));
    return glm::scale(m, scale);
}

// Fabrics that several objects share are baked once.
class FabricShelf
{
  public:
    FabricShelf(Scene& scene, const BakeOptions& options) : scene_(scene), options_(options) {}

    int take(const JsonValue& value, const Overrides& overrides)
    {
        std::string key = value.raw().dump();
        if (value.is_text()) key = std::filesystem::weakly_canonical(value.file()).string();
        for (const std::string& text : overrides) key += '\n' + text;
        const auto [place, fresh] = index_.try_emplace(key, int(scene_.fabrics.size()));
        if (!fresh) return place->second;
        const auto start = Clock::now();
        Fabric fabric = value.is_text() ? load_fabric(value.file(), overrides) : parse_fabric(value);
        scene_.fabrics.push_back(bake_fabric(fabric, options_));
        for (const std::string& warning : scene_.fabrics.back().warnings)
            scene_.warnings.push_back(fabric.name + ": " + warning);
        scene_.fabric_paths.emplace_back(value.is_text() ? value.file() : std::string());
        scene_.fabric_sources.push_back(std::move(fabric));
        scene_.seconds_bake += seconds_since(start);
        return place->second;
    }

  private:
    Scene& scene_;
    const BakeOptions& options_;
    std::map<std::string, int> index_;
};

SceneObject read_object(const JsonValue& value, const Overrides& fabric_overrides, FabricShelf& shelf, Scene& scene)
{
    value.expect_object({"mesh", "shape", "translate", "rotate", "scale", "fabric", "matte", "metal", "emission",
                         "uv_scale", "uv_rotation"});
    if (value.has("mesh") == value.has("shape")) value.fail("expected either \"mesh\" or \"shape\"");
    for (const auto& [one, other] : {std::pair("fabric", "matte"), {"fabric", "metal"}, {"matte", "metal"}})
        if (value.has(one) && value.has(other))
            value[other].fail("found both \"%s\" and \"%s\", expected one of them", one, other);
    if (value.has("fabric") && value.has("emission"))
        value["emission"].fail("found a fabric that shines, expected an object without fabric");

    SceneObject object;
    const std::string shape =
        value.has("shape") ? value["shape"].choice({"plane", "sphere", "cylinder", "drape", "curtain"}) : std::string();
    object.name = value.key() + " (" + (shape.empty() ? value["mesh"].text() : shape) + ")";
    glm::dmat2 tiles_from_uv(0.0);
    if (value.has("fabric")) {
        object.fabric = shelf.take(value["fabric"], fabric_overrides);
        const glm::dvec2 metres_per_uv =
            value.has("uv_scale") ? glm::dvec2(value["uv_scale"].number_or_vector2(1e-9, 1e6)) : glm::dvec2(1.0);
        const double turn = value.number("uv_rotation", 0.0, -36000.0, 36000.0) * radians_per_degree;
        const glm::dvec2 tile_m(scene.fabrics[std::size_t(object.fabric)].tile_m);
        // The fabric turns from +u toward +v, so a place on the surface turns the other way in the fabric.
        tiles_from_uv = {glm::dvec2(std::cos(turn), -std::sin(turn)) * metres_per_uv.x / tile_m,
                         glm::dvec2(std::sin(turn), std::cos(turn)) * metres_per_uv.y / tile_m};
    } else if (value.has("matte")) {
        value["matte"].expect_object({"albedo"});
        if (value["matte"].has("albedo")) object.albedo = value["matte"]["albedo"].number_or_vector3(0.0, 1.0);
    } else if (value.has("metal")) {
        const JsonValue metal = value["metal"];
        metal.expect_object({"colour", "roughness"});
        object.albedo = metal.has("colour") ? metal["colour"].number_or_vector3(0.0, 1.0) : glm::vec3(0.9f);
        object.roughness = float(metal.number("roughness", 0.1, cloth::f64::cloth_metal_alpha_min, 1.0));
    } else if (value.has("emission")) {
        object.albedo = glm::vec3(0.0f);
    }
    if (value.has("emission")) object.emission = value["emission"].number_or_vector3(0.0, bright_limit);
    const glm::dmat4 to_world = read_transform(value);
    object.shape = shape;
    object.to_world = to_world;
    object.tiles_from_uv = tiles_from_uv;
    // A fabric on one huge triangle would have no digits left for the place inside its repeat (math.md 10, hazard 16).
    const int divisions = object.fabric >= 0 ? 32 : 1;
    const SourceMesh source = shape.empty() ? load_mesh(value["mesh"].file(), object.fabric >= 0, scene.warnings)
                                            : make_shape(shape, divisions, scene.warnings);
    object.mesh =
        place_mesh(source, to_world, tiles_from_uv, shape.empty() ? value["mesh"].file() : object.name, scene.warnings);
    return object;
}

// ---- hash
// ---------------------------------------------------------------------------------------------------------------

// 64 bits over words: not for secrets, but any changed bit changes it.
class Hasher
{
  public:
    template <class T> void add(const std::vector<T>& values)
    {
        add_word(values.size());
        add_bytes(values.data(), values.size() * sizeof(T));
    }
    template <class T> void add(const T& value)
    {
        static_assert(std::has_unique_object_representations_v<T> || std::is_floating_point_v<T>);
        add_bytes(&value, sizeof(T));
    }
    void add(glm::vec3 v) { add(v.x), add(v.y), add(v.z); }
    void add(glm::vec2 v) { add(v.x), add(v.y); }
    void add_word(std::uint64_t word)
    {
        hash_ = (hash_ ^ word) * 0x9e3779b97f4a7c15u;
        hash_ ^= hash_ >> 32;
        hash_ *= 0xd6e8feb86659fd93u;
        hash_ ^= hash_ >> 29;
    }
    std::string text() const { return format_text("%016llx", static_cast<unsigned long long>(hash_)); }

  private:
    void add_bytes(const void* data, std::size_t size)
    {
        const char* at = static_cast<const char*>(data);
        for (; size >= 8; size -= 8, at += 8) {
            std::uint64_t word;
            std::memcpy(&word, at, 8);
            add_word(word);
        }
        std::uint64_t rest = 0;
        if (size > 0) std::memcpy(&rest, at, size);
        add_word(rest ^ (std::uint64_t(size) << 60));
    }
    std::uint64_t hash_ = 0x243f6a8885a308d3u;
};

std::string hash_of(const Scene& scene)
{
    Hasher hasher;
    hasher.add(scene.camera.position), hasher.add(scene.camera.target), hasher.add(scene.camera.up);
    hasher.add(scene.camera.fov_degrees), hasher.add(scene.camera.lens_radius), hasher.add(scene.camera.focus_m);
    hasher.add(scene.film.resolution.x), hasher.add(scene.film.resolution.y), hasher.add(scene.film.filter);
    for (const f32::ClothLight& light : scene.lights) {
        hasher.add(light.kind), hasher.add(light.pmf), hasher.add(light.position), hasher.add(light.axis);
        hasher.add(light.radiance), hasher.add(light.edge_u), hasher.add(light.edge_v), hasher.add(light.shape);
    }
    hasher.add(scene.environment.size.x), hasher.add(scene.environment.size.y), hasher.add(scene.environment.texels);
    for (const SceneObject& object : scene.objects) {
        hasher.add(object.fabric), hasher.add(object.albedo), hasher.add(object.roughness), hasher.add(object.light);
        hasher.add(object.mesh.positions), hasher.add(object.mesh.normals), hasher.add(object.mesh.triangles);
        hasher.add(object.mesh.corner_tiles);
    }
    for (const PackedFabric& fabric : scene.fabrics) {
        hasher.add(fabric.size.x), hasher.add(fabric.size.y), hasher.add(fabric.tile_m);
        for (const PackedSide& side : fabric.side)
            hasher.add(side.texels), hasher.add(side.horizons), hasher.add(side.slope_mips);
        for (const f32::ClothYarn& yarn : fabric.yarns) {
            hasher.add(yarn.albedo_r), hasher.add(yarn.albedo_t), hasher.add(yarn.diffuse_r),
                hasher.add(yarn.diffuse_t);
            hasher.add(yarn.alpha_r), hasher.add(yarn.alpha_t), hasher.add(yarn.thickness), hasher.add(yarn.twist);
            hasher.add(yarn.diffuse_mix), hasher.add(yarn.beneath);
            hasher.add(yarn.reflectance), hasher.add(yarn.transmittance), hasher.add(yarn.albedo);
        }
    }
    return hasher.text();
}

} // namespace

Scene load_scene(const std::filesystem::path& path, const Overrides& overrides)
{
    const auto start = Clock::now();
    Scene scene;
    const SortedOverrides sorted = sort_overrides(JsonValue::read(path.string()), overrides);
    const JsonValue root = JsonValue::read(path.string(), sorted.scene);
    root.expect_object({"$schema", "name", "camera", "film", "lights", "objects", "model"});
    if (root.has("model")) scene.model = parse_model(root["model"]);
    if (root.has("camera")) scene.camera = read_camera(root["camera"]);
    if (root.has("film")) scene.film = read_film(root["film"]);
    if (root.has("objects")) {
        const JsonValue list = root["objects"];
        if (!list.is_array()) list.fail("found something else, expected a list of objects");
        BakeOptions options;
        options.visibility = scene.model.visibility;
        options.stacked = scene.model.stacked;
        FabricShelf shelf(scene, options);
        const std::vector<JsonValue> entries = list.elements();
        for (std::size_t k = 0; k < entries.size(); ++k) {
            const auto found = sorted.fabric_of.find(k);
            scene.objects.push_back(
                read_object(entries[k], found == sorted.fabric_of.end() ? Overrides() : found->second, shelf, scene));
        }
    }
    if (root.has("lights")) read_lights(root["lights"], scene);
    add_shining_objects(scene);
    if (scene.objects.empty()) scene.warnings.push_back(path.string() + ": the scene has no objects");
    if (scene.lights.empty()) scene.warnings.push_back(path.string() + ": nothing in the scene shines");
    choose_probabilities(scene);
    scene.hash = hash_of(scene);
    scene.seconds_load = seconds_since(start) - scene.seconds_bake;
    return scene;
}

void turn_scene(Scene& scene, Turned what, double degrees)
{
    const double angle = degrees * radians_per_degree;
    const glm::dmat3 turn(glm::rotate(glm::dmat4(1.0), angle, glm::dvec3(0.0, 1.0, 0.0)));
    const glm::dvec3 centre = scene.camera.target;
    const auto turn_point = [&](glm::vec3& p) { p = glm::vec3(centre + turn * (glm::dvec3(p) - centre)); };
    const auto turn_vector = [&](glm::vec3& v) { v = glm::vec3(turn * glm::dvec3(v)); };
    if (what == Turned::camera) {
        turn_point(scene.camera.position);
        turn_vector(scene.camera.up);
    }
    for (SceneObject& object : scene.objects)
        if (what == (object.light >= 0 ? Turned::lights : Turned::objects)) {
            for (glm::vec3& p : object.mesh.positions) turn_point(p);
            for (glm::vec3& n : object.mesh.normals) turn_vector(n);
            for (int column = 0; column < 3; ++column)
                object.to_world[column] = glm::dvec4(turn * glm::dvec3(object.to_world[column]), 0.0);
            object.to_world[3] = glm::dvec4(centre + turn * (glm::dvec3(object.to_world[3]) - centre), 1.0);
        }
    if (what == Turned::lights) {
        for (f32::ClothLight& light : scene.lights) {
            if (light.kind == f32::cloth_light_mesh) continue;
            // The environment turns from -z toward +x, which is clockwise seen from above.
            if (light.kind == f32::cloth_light_environment) light.shape.x -= float(angle);
            turn_point(light.position);
            turn_vector(light.axis), turn_vector(light.edge_u), turn_vector(light.edge_v);
        }
        place_emitters(scene);
    }
    scene.hash = hash_of(scene);
}

void place_emitters(Scene& scene)
{
    constexpr std::size_t emitter_limit = std::size_t(1) << 24; // a float counts them
    scene.emitters.clear();
    for (const SceneObject& object : scene.objects) {
        if (object.light < 0) continue;
        const Mesh& mesh = object.mesh;
        const std::size_t count = mesh.triangles.size(), first = scene.emitters.size();
        if (first + count > emitter_limit)
            throw InputError("", 0, "%s: found more than %zu triangles that shine, expected less", object.name.c_str(),
                             emitter_limit);
        glm::dvec3 low(std::numeric_limits<double>::max()), high(-std::numeric_limits<double>::max());
        std::vector<double> areas, scaled;
        double area = 0.0, radius2 = 0.0;
        for (const glm::uvec3 i : mesh.triangles) {
            const glm::vec3 p0 = mesh.positions[i.x];
            const f32::ClothEmitter part{p0, mesh.positions[i.y] - p0, mesh.positions[i.z] - p0, 0, 0};
            areas.push_back(0.5 * glm::length(glm::cross(glm::dvec3(part.e1), glm::dvec3(part.e2))));
            area += areas.back();
            scene.emitters.push_back(part);
            for (const unsigned k : {i.x, i.y, i.z})
                low = glm::min(low, glm::dvec3(mesh.positions[k])),
                high = glm::max(high, glm::dvec3(mesh.positions[k]));
        }
        const std::vector<glm::uvec2> table = alias_table(areas, scaled);
        for (std::size_t k = 0; k < count; ++k)
            scene.emitters[first + k].threshold = table[k].x, scene.emitters[first + k].other = table[k].y;
        f32::ClothLight& light = scene.lights[std::size_t(object.light)];
        light.position = glm::vec3(0.5 * (low + high));
        for (const glm::vec3& p : mesh.positions)
            radius2 = std::max(radius2, glm::dot(glm::dvec3(p) - glm::dvec3(light.position),
                                                 glm::dvec3(p) - glm::dvec3(light.position)));
        // A little wider, so that no ray that rounding moves misses the ball and meets the mesh.
        light.edge_u = glm::vec3(float(area), float(1.0001 * std::sqrt(radius2)), 0.0f);
        light.shape = {float(first), float(count)};
    }
}

f32::ClothLens lens_of(const CameraSpec& camera)
{
    return {camera.lens_radius, camera.focus_m > 0.0f ? camera.focus_m : glm::distance(camera.position, camera.target)};
}

f32::ClothCamera make_camera(const CameraSpec& camera, glm::ivec2 resolution)
{
    const glm::dvec3 forward = glm::normalize(glm::dvec3(camera.target) - glm::dvec3(camera.position));
    const glm::dvec3 right = glm::normalize(glm::cross(forward, glm::dvec3(camera.up)));
    const glm::dvec3 up = glm::cross(right, forward);
    const double half = std::tan(0.5 * double(camera.fov_degrees) * radians_per_degree);
    const double aspect = double(resolution.x) / double(resolution.y);
    return {camera.position, glm::vec3(forward), glm::vec3(right * (half * aspect)), glm::vec3(up * half),
            glm::vec2(resolution)};
}

f32::ClothLights lights_of(const Scene& scene)
{
    f32::ClothLights lights;
    lights.count = int(scene.lights.size());
    lights.environment_size = scene.environment.size;
    lights.lights = scene.lights.data();
    lights.environment = scene.environment.texels.data();
    lights.inversion = scene.environment.inversion.data();
    lights.emitters = scene.emitters.data();
    return lights;
}

f32::ClothTriangle triangle_of(const SceneObject& object, std::size_t triangle)
{
    const Mesh& mesh = object.mesh;
    const glm::uvec3 i = mesh.triangles[triangle];
    const glm::vec2* tiles = mesh.corner_tiles.data() + 3 * triangle;
    return {mesh.positions[i.x],
            mesh.positions[i.y],
            mesh.positions[i.z],
            mesh.normals[i.x],
            mesh.normals[i.y],
            mesh.normals[i.z],
            tiles[0],
            tiles[1],
            tiles[2]};
}

bool lets_rays_through(const Scene& scene, const SceneObject& object)
{
    if (object.fabric < 0) return false;
    const PackedFabric& fabric = scene.fabrics[std::size_t(object.fabric)];
    const f32::ClothSettings& settings = scene.model.settings;
    return fabric.has_gaps || (settings.unscattered && fabric.lets_light_between_fibres);
}

} // namespace selvedge
