// tests/cpp/stability_inputs.cpp: the hunting distributions, one function for each kind of argument.
#include "tests/cpp/stability_inputs.hpp"

#include <algorithm>
#include <cmath>
#include <functional>
#include <map>
#include <numbers>
#include <optional>
#include <stdexcept>

#include "cloth_bsdf.hpp"

namespace stability
{

using Vec = glm::dvec3;
using std::numbers::pi;

namespace
{

std::uint64_t scramble(std::uint64_t x) // splitmix64's finaliser (Steele et al. 2014)
{
    x = (x ^ (x >> 30)) * 0xbf58476d1ce4e5b9u;
    x = (x ^ (x >> 27)) * 0x94d049bb133111ebu;
    return x ^ (x >> 31);
}

// Random numbers of one input.
class Draw
{
  public:
    Draw(std::uint64_t stream, std::uint64_t index) : key(scramble(stream ^ scramble(index + 0x9e3779b97f4a7c15u))) {}

    std::uint64_t bits() { return scramble(key + 0x9e3779b97f4a7c15u * ++count); }
    double share() { return static_cast<double>(bits() >> 11) * 0x1p-53; }
    double between(double low, double high) { return low + (high - low) * share(); }
    double log(double low, double high) { return low * std::pow(high / low, share()); } // even in the logarithm
    int whole(int count_of) { return static_cast<int>(bits() % static_cast<std::uint64_t>(count_of)); }
    int whole(int low, int high) { return low + whole(high - low + 1); }
    bool chance(int one_in) { return whole(one_in) == 0; }
    double sign() { return chance(2) ? -1 : 1; }
    template <class T> T one_of(std::initializer_list<T> items)
    {
        return items.begin()[whole(static_cast<int>(items.size()))];
    }

  private:
    std::uint64_t key, count = 0;
};

std::uint64_t stream_of(std::string_view name) // FNV-1a
{
    std::uint64_t hash = 0xcbf29ce484222325u;
    for (const char c : name) hash = (hash ^ static_cast<unsigned char>(c)) * 0x100000001b3u;
    return hash;
}

Vec unit(Vec v)
{
    const double length = glm::length(v);
    return length > 0 ? v / length : Vec(0, 0, 1);
}

Vec sphere(Draw& draw)
{
    const double z = draw.between(-1, 1), phi = draw.between(0, 2 * pi), r = std::sqrt(1 - z * z);
    return {r * std::cos(phi), r * std::sin(phi), z};
}

Vec near(Draw& draw, Vec d, double farthest)
{
    return unit(d + sphere(draw) * draw.log(1e-8, farthest));
}

Vec across(Draw& draw, Vec d)
{
    return unit(glm::cross(d, sphere(draw)));
}

// Any direction; axes, nearly axes, in a plane of two axes, nearly level.
Vec direction(Draw& draw)
{
    Vec d = sphere(draw);
    const int axis = draw.whole(3);
    Vec e(0);
    e[axis] = draw.sign();
    switch (draw.whole(10)) {
    case 0:
        return e;
    case 1:
        return near(draw, e, 0.1);
    case 2:
        d[axis] = 0;
        return unit(d);
    case 3:
        d.z = draw.sign() * draw.log(1e-7, 0.1);
        return unit(d);
    case 4:
        d[axis] = draw.sign() * draw.log(1e-38, 1e-6);
        return unit(d);
    default:
        return d;
    }
}

// Where the parts of one input stand in relation to each other.
struct Context {
    std::optional<Vec> direction, viewer, normal, tangent, position;
    std::optional<glm::dmat3> corners;
};

// o.z > 0: straight, nearly so, grazing to 1e-7, along the fibre, and nearly level with the ply.
Vec viewer(Draw& draw, const Context& context)
{
    Vec d = sphere(draw);
    switch (draw.whole(12)) {
    case 0:
        d = Vec(0, 0, 1);
        break;
    case 1:
        d = near(draw, Vec(0, 0, 1), 0.1);
        break;
    case 2:
    case 3:
        d.z = draw.log(1e-7, 0.3) * glm::length(glm::dvec2(d));
        break;
    case 4:
        if (context.tangent) d = *context.tangent;
        break;
    case 5:
        if (context.tangent) d = near(draw, *context.tangent, 0.1);
        break;
    case 6:
        if (context.normal) d = unit(across(draw, *context.normal) + *context.normal * draw.log(1e-8, 0.1));
        break;
    case 7:
        if (context.normal) d = *context.normal;
        break;
    default:
        break;
    }
    if (d.z < 0) d = -d;
    d.z = std::max(d.z, 1e-7);
    return unit(d);
}

// The light's direction in relation to the viewer's: equal, opposite, nearly so, mirrored, level, grazing; or any.
Vec light_direction(Draw& draw, Vec o)
{
    Vec d = direction(draw);
    switch (draw.whole(14)) {
    case 0:
        return o;
    case 1:
        return -o;
    case 2:
        return near(draw, o, 0.1);
    case 3:
    case 4:
        return near(draw, -o, 0.1);
    case 5:
        return {-o.x, -o.y, o.z};
    case 6:
        return {o.x, o.y, -o.z};
    case 7:
        d.z = 0;
        return unit(d);
    case 8:
    case 9:
        d.z = draw.sign() * draw.log(1e-7, 0.1);
        return unit(d);
    case 10:
        d.z = draw.sign() * draw.log(1e-44, 1e-7);
        return unit(d);
    default:
        return d;
    }
}

Vec tangent_to(Draw& draw, Vec d)
{
    switch (draw.whole(10)) {
    case 0:
        return d;
    case 1:
        return -d;
    case 2:
    case 3:
        return near(draw, d * draw.sign(), 0.1);
    case 4:
        return across(draw, d);
    case 5:
        return near(draw, across(draw, d), 0.01);
    default:
        return direction(draw);
    }
}

double roughness(Draw& draw)
{
    return draw.chance(4) ? 0.01 : draw.chance(12) ? 1.0 : draw.log(0.01, 1);
}

double slope(Draw& draw)
{
    switch (draw.whole(8)) {
    case 0:
        return 4 * draw.sign();
    case 1:
        return 0;
    case 2:
        return draw.sign() * draw.log(1e-4, 1);
    default:
        return draw.between(-4, 4);
    }
}

double random_number(Draw& draw) // [0, 1) as cloth_unit makes it, the ends often
{
    if (draw.chance(12)) return draw.chance(2) ? 0.0 : 1 - 0x1p-24;
    if (draw.chance(12)) return draw.whole(1, 64) * 0x1p-24;
    return static_cast<double>(draw.bits() >> 40) * 0x1p-24;
}

double part(Draw& draw) // [0, 1]
{
    return draw.chance(6) ? draw.whole(2) : draw.chance(6) ? draw.log(1e-8, 1) : draw.share();
}

double intensity(Draw& draw)
{
    return draw.chance(20) ? 0 : draw.log(1e-8, 1e8);
}

// Three albedos of one kind: mostly any, sometimes black, white, or one channel alone.
Vec albedo(Draw& draw)
{
    const Vec some(draw.share(), draw.share(), draw.share());
    switch (draw.whole(10)) {
    case 0:
        return Vec(0);
    case 1:
        return Vec(1);
    case 2:
        return some * Vec(draw.whole(2), draw.whole(2), draw.whole(2));
    case 3:
        return some * draw.log(1e-8, 1);
    default:
        return some;
    }
}

// Writes numbers one after the other.
class Writer
{
  public:
    explicit Writer(double* first) : next(first) {}
    void put(double x)
    {
        // volatile: GCC 12 vectorises three of these in a row and loses the rounding.
        const volatile float rounded = static_cast<float>(x);
        *next++ = static_cast<double>(rounded);
    }
    void put(glm::dvec2 v) { put(v.x), put(v.y); }
    void put(Vec v) { put(v.x), put(v.y), put(v.z); }
    double* next;
};

void put_yarn(Draw& draw, Writer& out)
{
    for (int lobe = 0; lobe < 4; ++lobe) out.put(albedo(draw));
    out.put(roughness(draw));
    out.put(roughness(draw));
    out.put(draw.chance(3) ? draw.log(1e-6, 1e4) : draw.log(0.1, 10));
    out.put(draw.chance(4) ? draw.between(-pi, pi) : draw.between(-0.6, 0.6));
    out.put(part(draw));
}

// Ply normals of slopes to the clamp, with their lengths; fibres as the maps give them, and against all rules along a
// normal.
void put_point(Draw& draw, Writer& out, Context& context)
{
    const Vec area_f(-slope(draw), -slope(draw), 1), area_b(-slope(draw), -slope(draw), 1);
    const Vec f = unit(area_f), b = unit(area_b);
    const double phi = draw.between(0, pi), omega = draw.chance(4) ? 0 : draw.between(-pi, pi);
    Vec t = unit(Vec(std::cos(phi), std::sin(phi), -(area_f.x * std::cos(phi) + area_f.y * std::sin(phi))));
    t = std::cos(omega) * t + std::sin(omega) * glm::cross(f, t);
    switch (draw.whole(16)) {
    case 0:
        t = f * draw.sign();
        break;
    case 1:
        t = near(draw, f * draw.sign(), 0.01);
        break;
    case 2:
        t = b * Vec(1, 1, -1);
        break;
    default:
        break;
    }
    context.normal = f;
    context.tangent = t;
    out.put(f);
    out.put(b);
    out.put(t);
    out.put(glm::length(area_f));
    out.put(glm::length(area_b));
}

// 19 numbers. The loader's limits: half angles of suns to 90 degrees, cones from 0.01, edges from 1e-6 m.
// Triangles of shining objects, small and large, near and far from the origin, and what a light knows of each object.
struct Emitters {
    struct Object {
        int first = 0, count = 0;
        double area = 0, radius = 0; // [m2], of a ball about `centre` [m]
        Vec centre{0};
    };
    std::vector<Object> objects;
    std::vector<double> numbers; // row_emitter_numbers a triangle
};

const Emitters& emitters()
{
    static const Emitters all = [] {
        Emitters e;
        Draw draw(stream_of("emitters"), 0);
        for (int object = 0; object < 16; ++object) {
            Emitters::Object o;
            o.first = static_cast<int>(e.numbers.size()) / row_emitter_numbers;
            o.count = draw.whole(1, 4);
            o.centre = draw.chance(4) ? Vec(0) : sphere(draw) * draw.log(1e-3, 1e4);
            const double size = draw.log(1e-3, 1e3);
            for (int k = 0; k < o.count; ++k) {
                const Vec corner = o.centre + sphere(draw) * size, x = direction(draw),
                          y = across(draw, x) + x * draw.between(-1, 1); // no slivers: the loader gives them no light
                const double length = size * draw.log(1e-2, 1);
                const std::size_t at = e.numbers.size();
                e.numbers.resize(at + row_emitter_numbers);
                Writer out(e.numbers.data() + at);
                out.put(corner), out.put(x * length), out.put(y * length);
                const std::uint32_t threshold = static_cast<std::uint32_t>(draw.bits());
                out.put(threshold & 0xffffu), out.put(threshold >> 16);
                out.put(draw.whole(o.count)), out.put(0);
                o.area += 0.5 * glm::length(glm::cross(x * length, y * length));
                o.radius = std::max(o.radius, glm::length(corner - o.centre) + 3 * length);
            }
            e.objects.push_back(o);
        }
        return e;
    }();
    return all;
}

void put_light(Draw& draw, Writer& out, Context& context, int kind)
{
    if (kind == 6) {
        const Emitters::Object& o = emitters().objects[static_cast<std::size_t>(draw.whole(16))];
        context.position = o.centre;
        context.direction = direction(draw);
        out.put(kind);
        out.put(draw.chance(4) ? 1 : draw.log(1e-6, 1));
        out.put(o.centre);
        out.put(Vec(0, 0, 1));
        for (int channel = 0; channel < 3; ++channel) out.put(intensity(draw));
        out.put(Vec(o.area, o.radius, 0));
        out.put(Vec(0));
        out.put(o.first), out.put(o.count);
        return;
    }
    const Vec axis = direction(draw), position = draw.chance(8) ? Vec(0) : sphere(draw) * draw.log(1e-3, 1e4);
    const Vec x = across(draw, axis), y = glm::cross(axis, x);
    const double size = draw.log(1e-6, 1e3), ratio = draw.chance(4) ? draw.log(1e-3, 1) : 1;
    glm::dvec2 shape(0);
    if (kind == 0) shape.x = draw.chance(4) ? 0 : draw.between(-7, 7);
    if (kind == 1) {
        const double half = draw.chance(4) ? 0 : draw.chance(8) ? 0.5 * pi : draw.log(1e-7, 0.5 * pi);
        shape.x = 2 * std::sin(0.5 * half) * std::sin(0.5 * half);
    }
    if (kind == 3) {
        const double cone = draw.log(1e-4, pi), penumbra = draw.chance(3) ? 0 : cone * part(draw);
        shape = {std::cos(cone), std::cos(cone - penumbra)};
    }
    context.position = position;
    context.direction = axis;
    out.put(kind);
    out.put(draw.chance(4) ? 1 : draw.log(1e-6, 1));
    out.put(position);
    out.put(axis);
    for (int channel = 0; channel < 3; ++channel) out.put(intensity(draw));
    out.put(x * size);
    out.put(y * size * ratio);
    out.put(shape);
}

// A place in relation to a light at `at` that shines along `axis`: in it, next to it, in its plane, behind it, far off.
Vec place(Draw& draw, Vec at, Vec axis)
{
    switch (draw.whole(8)) {
    case 0:
        return at;
    case 1:
        return at + sphere(draw) * draw.log(1e-12, 1e-3);
    case 2:
        return at + axis * draw.sign() * draw.log(1e-6, 1e3);
    case 3:
        return at + across(draw, axis) * draw.log(1e-6, 1e3);
    case 4:
        return at + (across(draw, axis) + axis * draw.sign() * draw.log(1e-7, 0.1)) * draw.log(1e-6, 1e3);
    case 5:
        return sphere(draw) * draw.log(1e-3, 1e6);
    default:
        return at + sphere(draw) * draw.log(1e-2, 1e2);
    }
}

// Corners of a triangle: of any size, far from the origin, slivers, without area; UVs with and without area, to 1e6
// repeats; vertex normals along and across, opposite and none at all.
void put_triangle(Draw& draw, Writer& out, Context& context)
{
    const double size = draw.chance(3) ? draw.log(1e-6, 1e4) : draw.log(1e-3, 1);
    const Vec at = draw.chance(3) ? sphere(draw) * draw.log(1e-3, 1e4) : sphere(draw);
    glm::dmat3 p;
    for (int k = 0; k < 3; ++k) p[k] = at + sphere(draw) * size * draw.share();
    switch (draw.whole(16)) {
    case 0:
        p[1] = p[0];
        break;
    case 1:
        p[1] = p[2] = p[0];
        break;
    case 2:
        p[2] = p[0] + (p[1] - p[0]) * draw.between(-1, 2);
        break;
    case 3:
        p[2] = p[0] + (p[1] - p[0]) * draw.between(-1, 2) + sphere(draw) * size * draw.log(1e-9, 1e-2);
        break;
    case 4:
        p[2] = p[1] + sphere(draw) * size * draw.log(1e-9, 1e-2);
        break;
    case 5:
        for (int k = 0; k < 3; ++k) p[k].y = at.y;
        break;
    default:
        break;
    }
    // Rounded here, so that a ray can meet the triangle as it will be read.
    for (int k = 0; k < 3; ++k)
        for (int c = 0; c < 3; ++c) {
            const volatile float rounded = static_cast<float>(p[k][c]);
            p[k][c] = static_cast<double>(rounded);
        }
    context.corners = p;
    const Vec n = unit(glm::cross(p[1] - p[0], p[2] - p[0]));
    context.normal = n;
    for (int k = 0; k < 3; ++k) out.put(p[k]);
    const int normals = draw.whole(8);
    for (int k = 0; k < 3; ++k) {
        Vec v = unit(n + 0.3 * sphere(draw));
        if (normals == 0) v = n;
        if (normals == 1) v = direction(draw);
        if (normals == 2) v = across(draw, n);
        if (normals == 3 && k < 2) v = k == 0 ? n : -n;
        if (normals == 4) v = v * draw.log(1e-12, 1e12);
        if (normals == 5) v = Vec(0);
        out.put(v);
    }
    const double repeats = draw.chance(2) ? draw.log(1e-6, 1e6) : 1;
    glm::dvec2 t[3];
    for (glm::dvec2& uv : t) uv = glm::dvec2(draw.between(-1, 1), draw.between(-1, 1)) * repeats;
    switch (draw.whole(14)) {
    case 0:
        t[1] = t[2] = t[0];
        break;
    case 1:
        t[1] = t[0];
        break;
    case 2:
        t[2] = 2.0 * t[1] - t[0];
        break;
    case 3:
        t[2] = t[0] + (t[1] - t[0]) * draw.between(-1, 2) + glm::dvec2(draw.sign(), 0) * draw.log(1e-9, 1e-3) * repeats;
        break;
    case 4:
        t[2].x = t[1].x = t[0].x;
        break;
    case 5:
        for (glm::dvec2& uv : t) uv = glm::dvec2(0);
        break;
    default:
        break;
    }
    for (const glm::dvec2& uv : t) out.put(uv);
}

// A camera ray at the triangle: straight on, grazing, from within its plane, from very near and far; sometimes past it.
void put_ray(Draw& draw, Writer& out, const Context& context)
{
    const glm::dmat3 p = context.corners.value();
    const Vec n = context.normal.value();
    double b1 = draw.share(), b2 = draw.share();
    if (b1 + b2 > 1) b1 = 1 - b1, b2 = 1 - b2;
    if (draw.chance(16)) b1 = draw.whole(2), b2 = 0;
    Vec on = p[0] + (p[1] - p[0]) * b1 + (p[2] - p[0]) * b2;
    if (draw.chance(16)) on += sphere(draw) * glm::length(p[1] - p[0]);
    Vec away = sphere(draw);
    switch (draw.whole(8)) {
    case 0:
        away = n * draw.sign();
        break;
    case 1:
    case 2:
        away = unit(across(draw, n) + n * draw.sign() * draw.log(1e-7, 0.1));
        break;
    case 3:
        away = across(draw, n);
        break;
    default:
        break;
    }
    const Vec eye = on + away * draw.log(1e-4, 1e4);
    const Vec forward = unit(unit(-away) + 0.3 * sphere(draw));
    const Vec d = -away / std::max(glm::dot(-away, forward), 1e-2);
    const Vec x = across(draw, forward), y = glm::cross(forward, x);
    const double step = draw.log(1e-6, 1e-1), ratio = draw.chance(4) ? draw.log(1e-2, 1e2) : 1;
    out.put(eye);
    out.put(d);
    out.put(x * step);
    out.put(-y * step * ratio);
}

// A fabric's size [m], heights [m], cells and amplitude of the twist noise.
// Size of the repeat and of its relief.
void put_relief(Draw& draw, Writer& out)
{
    const glm::dvec2 tile(draw.log(1e-5, 1), draw.log(1e-5, 1));
    out.put(tile);
    const double deep = draw.chance(6) ? 0 : std::min(tile.x, tile.y) * draw.log(1e-6, 1);
    const Vec low = -deep * Vec(part(draw), part(draw), 0), high = deep * Vec(part(draw), part(draw), 0);
    out.put(glm::dvec2(low));
    out.put(glm::dvec2(high));
}

void put_fabric(Draw& draw, Writer& out)
{
    put_relief(draw, out);
    out.put(draw.whole(1, draw.chance(4) ? 4096 : 8));
    out.put(draw.whole(1, draw.chance(4) ? 4096 : 8));
    out.put(draw.chance(3) ? 0 : draw.log(1e-4, 1));
}

glm::dvec2 tile_position(Draw& draw)
{
    if (draw.chance(10)) return {draw.whole(-2, 2), draw.whole(-2, 2)};
    // Positions come less their whole repeats (ClothFootprint.base); a big triangle adds some.
    const double range = draw.chance(4) ? draw.log(1, 1e4) : 1;
    glm::dvec2 tile(draw.between(-range, range), draw.between(-range, range));
    if (draw.chance(12)) tile = glm::round(tile * 48.0) / 48.0 + draw.sign() * draw.log(1e-12, 1e-6);
    return tile;
}

// No extent, up to 1e6 texels; long and thin.
void put_footprint(Draw& draw, Writer& out)
{
    out.put(tile_position(draw));
    // 64 tiles are what cloth_surface lets through; 1e6 texels of this map are more.
    const double extent = draw.chance(8) ? 0 : draw.chance(8) ? 1e6 / 48 : draw.log(1e-9, 1e6 / 48);
    const double thin = draw.chance(3) ? draw.log(1e-8, 1) : 1, phi = draw.between(0, 2 * pi),
                 skew = draw.between(0, 2 * pi);
    out.put(extent * glm::dvec2(std::cos(phi), std::sin(phi)));
    out.put(extent * thin * glm::dvec2(std::cos(skew), std::sin(skew)));
}

Vec colour(Draw& draw)
{
    const double scale = intensity(draw);
    switch (draw.whole(5)) {
    case 0:
        return Vec(scale);
    case 1:
        return Vec(draw.whole(2), draw.whole(2), draw.whole(2)) * scale;
    case 2:
        return Vec(draw.between(0, 1.2), draw.between(0, 1.2), draw.between(0, 1.2));
    case 3:
        return {intensity(draw), intensity(draw), intensity(draw)};
    default:
        return albedo(draw) * scale;
    }
}

} // namespace

struct Kind {
    int width;
    bool measured; // moved by move_inputs
    std::function<void(Draw&, Writer&, Context&)> draw;
    bool in_unit_interval = false;
};

namespace
{

Kind whole_kind(int low, int high)
{
    return {1, false, [=](Draw& draw, Writer& out, Context&) { out.put(draw.whole(low, high)); }};
}

Kind number_kind(double (*of)(Draw&))
{
    return {1, true, [=](Draw& draw, Writer& out, Context&) { out.put(of(draw)); }};
}

Kind light_kind(int lowest, int highest)
{
    return {row_light_numbers, true, [=](Draw& draw, Writer& out, Context& context) {
                put_light(draw, out, context, draw.whole(lowest, highest));
            }};
}

Vec remember(std::optional<Vec>& where, Vec what)
{
    where = what;
    return what;
}

const std::map<std::string_view, Kind>& kinds()
{
    static const std::map<std::string_view, Kind> all = {
        {"direction", {3, true, [](Draw& d, Writer& o, Context& c) { o.put(remember(c.direction, direction(d))); }}},
        {"viewer",
         {3, true,
          [](Draw& d, Writer& o, Context& c) { o.put(c.viewer ? *c.viewer : remember(c.viewer, viewer(d, c))); }}},
        {"light",
         {3, true,
          [](Draw& d, Writer& o, Context& c) {
              if (!c.viewer) c.viewer = viewer(d, c);
              o.put(remember(c.direction, light_direction(d, *c.viewer)));
          }}},
        {"vector",
         {3, true,
          [](Draw& d, Writer& o, Context&) { o.put(d.chance(16) ? Vec(0) : direction(d) * d.log(1e-15, 1e15)); }}},
        {"half", // i + o is not shorter than 1e-4, or the limit is taken
         {3, true,
          [](Draw& d, Writer& o, Context& c) { o.put(remember(c.direction, direction(d)) * d.log(1e-4, 2)); }}},
        {"tangent",
         {3, true,
          [](Draw& d, Writer& o, Context& c) { o.put(tangent_to(d, c.direction ? *c.direction : direction(d))); }}},
        {"alpha", number_kind(roughness)},
        {"metal_alpha", number_kind([](Draw& d) { return d.chance(6) ? 1e-3 : d.chance(6) ? 1 : d.log(1e-3, 1); })},
        {"lens", // radius, distance in focus
         {2, true, [](Draw& d, Writer& o, Context&) { o.put(d.chance(4) ? 0 : d.log(1e-6, 10)), o.put(d.log(1e-3, 1e5)); }}},
        {"u", {1, true, number_kind(random_number).draw, true}},
        {"part", number_kind(part)},
        {"depth", number_kind([](Draw& d) {
             return d.chance(8) ? 0 : d.chance(8) ? d.between(0.09, 0.11) : d.log(1e-30, 1e10);
         })},
        {"density", number_kind([](Draw& d) { return d.log(3e-7, 32); })},
        {"sigma", number_kind([](Draw& d) { return d.chance(8)   ? 0.01
                                                   : d.chance(8) ? 1
                                                                 : d.log(0.01, 1); })},
        {"cosine", number_kind([](Draw& d) {
             return d.chance(10) ? 0 : d.chance(10) ? 1 : d.log(d.chance(8) ? 1e-44 : 1e-8, 1);
         })},
        {"thickness", number_kind([](Draw& d) { return d.log(1e-6, 1e4); })},
        {"weight", number_kind([](Draw& d) { return d.chance(3)   ? 1
                                                    : d.chance(6) ? 0
                                                                  : d.log(1e-6, 1e3); })},
        {"angle", number_kind([](Draw& d) { return d.chance(4) ? 0 : d.between(-7, 7); })},
        {"bandwidth", number_kind([](Draw& d) { return d.chance(8) ? 0 : d.log(1e-3, 1e4); })},
        {"amplitude", number_kind([](Draw& d) { return d.chance(8) ? 1 : d.log(1e-6, 1e3); })},
        {"level", whole_kind(-1, 40)},
        {"bool", whole_kind(0, 1)},
        {"side", whole_kind(0, 1)},
        {"three", whole_kind(0, 2)},
        {"slots",
         {2, false,
          [](Draw& d, Writer& o, Context&) {
              const auto count = 1 + d.whole(cloth::f32::cloth_lights_asked);
              o.put(d.whole(count)), o.put(count);
          }}},
        {"zero", whole_kind(0, 0)},
        {"offset", {1, false, [](Draw& d, Writer& o, Context&) { o.put(16 * d.whole(64)); }}},
        {"exposure", number_kind([](Draw& d) { return d.between(-20, 20); })},
        {"value", number_kind(intensity)},
        {"share_colour", {3, true, [](Draw& d, Writer& o, Context&) { o.put(Vec(part(d), part(d), part(d))); }}},
        {"albedo", {3, true, [](Draw& d, Writer& o, Context&) { o.put(albedo(d)); }}},
        {"colour", {3, true, [](Draw& d, Writer& o, Context&) { o.put(colour(d)); }}},
        {"plane",
         {2, true,
          [](Draw& d, Writer& o, Context&) { o.put(glm::dvec2(direction(d)) * (d.chance(8) ? d.log(1e-30, 1) : 1)); }}},
        {"word",
         {2, false,
          [](Draw& d, Writer& o, Context&) {
              const std::uint32_t word =
                  d.chance(10) ? d.one_of({0u, 1u, 0xffffffffu, 0x80000000u}) : static_cast<std::uint32_t>(d.bits());
              o.put(word & 0xffffu);
              o.put(word >> 16);
          }}},
        {"slope_word",
         {2, false,
          [](Draw& d, Writer& o, Context&) {
              for (int k = 0; k < 2; ++k)
                  o.put(d.chance(4) ? d.one_of({0, 0x7fff, 0x8000, 0x8001, 0xffff}) : d.whole(65536));
          }}},
        {"texel",
         {2, false,
          [](Draw& d, Writer& o, Context&) {
              o.put(d.whole(row_tables().size.x)), o.put(d.whole(row_tables().size.y));
          }}},
        {"spot",
         {2, false,
          [](Draw& d, Writer& o, Context&) {
              o.put(d.whole(4 * row_tables().size.x)), o.put(d.whole(4 * row_tables().size.y));
          }}},
        {"base",
         {2, false,
          [](Draw& d, Writer& o, Context&) { o.put(d.whole(-1000000, 1000000)), o.put(d.whole(-1000000, 1000000)); }}},
        {"tile", {2, true, [](Draw& d, Writer& o, Context&) { o.put(tile_position(d)); }}},
        {"footprint", {6, true, [](Draw& d, Writer& o, Context&) { put_footprint(d, o); }}},
        {"relief", {6, true, [](Draw& d, Writer& o, Context&) { put_relief(d, o); }}},
        {"kind_of_visibility", whole_kind(0, cloth::f64::cloth_visibility_exact)},
        {"fabric", {9, true, [](Draw& d, Writer& o, Context&) { put_fabric(d, o); }}},
        {"settings",
         {7, false,
          [](Draw& d, Writer& o, Context&) {
              for (const int count : {2, 4, 6, 2, 2, 2, 2}) o.put(d.whole(count));
          }}},
        {"point", {11, true, [](Draw& d, Writer& o, Context& c) { put_point(d, o, c); }}},
        {"yarn", {row_yarn_numbers, true, [](Draw& d, Writer& o, Context&) { put_yarn(d, o); }}},
        {"horizon",
         {4, false,
          [](Draw& d, Writer& o, Context&) {
              const int pattern = d.whole(4);
              for (int half = 0; half < 4; ++half)
                  o.put(pattern == 0 ? 0 : pattern == 1 ? d.whole(65536) & 0x0f0f : d.whole(65536));
          }}},
        {"cap", // a mean direction over the horizon, any angle and axes
         {4, true,
          [](Draw& d, Writer& o, Context& c) {
              const Vec mean = viewer(d, c) * 32767.0;
              for (const int axis : {0, 1}) o.put(static_cast<int>(std::lround(mean[axis])) & 0xffff);
              for (int half = 0; half < 2; ++half) o.put(d.chance(8) ? d.one_of({0, 0xffff}) : d.whole(65536));
          }}},
        {"camera",
         {14, true,
          [](Draw& d, Writer& o, Context&) {
              const Vec forward = direction(d), x = across(d, forward), y = glm::cross(forward, x);
              o.put(sphere(d) * d.log(1e-3, 1e5));
              o.put(forward);
              o.put(x * d.log(1e-4, 1e2));
              o.put(y * d.log(1e-4, 1e2));
              o.put(d.whole(1, 16384)), o.put(d.whole(1, 16384));
          }}},
        {"raster",
         {2, true, [](Draw& d, Writer& o, Context&) { o.put(glm::dvec2(d.share(), d.share()) * d.log(1, 16384)); }}},
        {"triangle", {24, true, [](Draw& d, Writer& o, Context& c) { put_triangle(d, o, c); }}},
        {"ray", {12, true, [](Draw& d, Writer& o, Context& c) { put_ray(d, o, c); }}},
        {"position", // in relation to the light that came before, or to the triangle
         {3, true,
          [](Draw& d, Writer& o, Context& c) {
              if (c.corners) {
                  const glm::dmat3& p = *c.corners;
                  const double away = d.chance(2) ? 0 : d.log(1e-6, 10);
                  o.put(p[0] + (p[1] - p[0]) * d.between(-0.5, 1.5) + (p[2] - p[0]) * d.between(-0.5, 1.5) +
                        sphere(d) * away);
              } else if (c.position) {
                  o.put(remember(c.position, place(d, *c.position, *c.direction)));
              } else {
                  // One of the table's lights: they are what cloth_direct will choose from.
                  const std::vector<float>& lights = row_tables().lights;
                  const float* light =
                      lights.data() + row_light_numbers * d.whole(static_cast<int>(lights.size()) / row_light_numbers);
                  o.put(place(d, Vec(light[2], light[3], light[4]), Vec(light[5], light[6], light[7])));
              }
          }}},
        {"toward", // a direction, half of the time at the light that came before
         {3, true,
          [](Draw& d, Writer& o, Context& c) {
              o.put(d.chance(2) ? direction(d) : near(d, d.chance(2) ? -*c.direction : *c.direction, 1));
          }}},
        {"geometric", // a geometric normal for the shading normal that came before
         {3, true,
          [](Draw& d, Writer& o, Context& c) { o.put(d.chance(3) ? *c.direction : near(d, *c.direction, 1)); }}},
        {"frame", // of a surface, either handedness
         {9, true,
          [](Draw& d, Writer& o, Context& c) {
              const Vec z = remember(c.direction, direction(d)), x = across(d, z);
              o.put(x);
              o.put(glm::cross(z, x) * d.sign());
              o.put(z);
          }}},
        {"random",
         {5, false,
          [](Draw& d, Writer& o, Context&) {
              o.put(d.whole(65536)), o.put(d.whole(65536));
              o.put(d.whole(64)), o.put(0);
              o.put(16 * d.whole(4));
          }}},
        {"any_light", light_kind(0, 6)},
        {"environment_light", light_kind(0, 0)},
    };
    return all;
}

const std::map<std::string_view, Output>& output_kinds()
{
    constexpr double all = std::numeric_limits<double>::infinity();
    // clang-format off
    static const std::map<std::string_view, Output> kinds = {
        {"positive", {1, 1e-15, 0, all, false, ""}},
        {"colour", {3, 1e-15, 0, all, false, ""}},
        {"share", {1, 1e-6, 0, 1.00001, false, ""}},
        {"coordinate", {1, 1, 0, 1, false, ""}},
        {"octant", {1, 1, 0, 8, false, ""}},
        {"display", {3, 1e-4, 0, 1.00001, false, ""}},
        {"unit", {3, 1, -1.001, 1.001, true, ""}},
        {"number", {1, 1, -all, all, false, ""}},
        {"pair", {2, 1, -all, all, false, ""}},
        {"vector", {3, 1e-20, -all, all, false, ""}},
        {"tiles", {2, 1e-3, -all, all, false, ""}},
        {"word", {2, 1, 0, 65535, false, ""}},
        {"whole", {1, 1, -all, all, false, ""}},
    };
    // clang-format on
    return kinds;
}

// function: arguments > results
const char* const signatures[] = {
    "frame: direction > unit unit unit",
    "unit_vector: vector direction > unit",
    "sggx_sigma: direction tangent alpha > positive",
    "sggx_d: half tangent alpha > positive",
    "sggx_d_antiparallel: direction tangent alpha > positive",
    "sggx_d_half: light viewer tangent alpha > positive",
    "sggx_sample_vndf: direction tangent alpha u u > unit",
    "phi1: depth > share",
    "slab_reflect: density sigma sigma cosine cosine thickness > positive",
    "slab_transmit: density sigma sigma cosine cosine thickness > positive",
    "diffuse: direction light part > positive",
    "point_value: point yarn light viewer bool > colour",
    "unscattered: point yarn viewer thickness > share",
    "interreflection: share_colour part part > colour colour",
    "lobe_weights: yarn > share share share share",
    "point_pdf: point yarn light viewer > positive",
    "cosine_sample: direction u u > unit",
    "point_sample: point yarn viewer u u u u > unit positive",
    "point_beneath: point yarn light viewer bool direction thickness u u u u > colour positive unit positive",
    "ggx_d: direction metal_alpha > positive",
    "ggx_stretch: direction metal_alpha > positive",
    "fresnel_schlick: share_colour part > share share share",
    "metal_value: share_colour metal_alpha light viewer > colour",
    "metal_pdf: metal_alpha light viewer > positive",
    "metal_sample: metal_alpha viewer u u > unit positive",
    "horizon_azimuth: plane > octant",
    "horizon_step: part part > share",
    "horizon_visibility: horizon direction > share",
    "cap_visibility: cap direction > share",
    "asg_visibility: viewer angle bandwidth bandwidth amplitude zero direction > share",
    "visibility_at: side spot kind_of_visibility direction relief > share",
    "decode_slopes: slope_word > pair",
    "texel_at: tile > whole whole",
    "texel: side texel > unit unit unit positive positive pair whole whole share",
    "horizon_at: spot > whole whole",
    "mean_slopes: side tile level > pair",
    "area_from_mips: side footprint viewer > positive",
    "select: side footprint viewer bool three three word word offset > whole positive unit unit unit positive positive "
    "pair "
    "whole whole share",
    "bend: side texel u > unit colour positive positive",
    "transmittance: tile direction bool three bool > positive",
    "noise: word word u u > number",
    "camera_ray: camera raster > vector vector vector vector",
    "lens_camera: camera lens u u > vector vector",
    "filter_offset: bool u u > pair",
    "barycentric: triangle position > pair",
    "uv_frame: triangle direction > unit unit unit",
    "surface: triangle ray > vector unit unit unit unit unit tiles tiles tiles whole",
    "leave: position direction > vector",
    "environment_direction: u u angle > unit",
    "environment_uv: direction angle > coordinate coordinate",
    "environment: environment_light direction > colour positive",
    "light_sample: any_light position u u word word > unit positive colour positive",
    "light_hit: any_light position toward > unit positive colour positive",
    "ask_light: u slots > whole share share",
    "least: value value > positive",
    "shadow_roulette: part u part > positive share",
    "tone_neutral: colour > display",
    "srgb: share_colour > display",
    "display: colour exposure > display",
    "relmse_term: value value > positive",
    "hash: word > word",
    "hash_combine: word word > word",
    "random_bits: word word word > word word",
    "random: word word word > share share",
    "block_length: word > whole",
    "texel_noise: fabric side texel base > unit unit unit positive positive pair whole whole share",
    "march: fabric side tile viewer u > tiles",
    "visibility: side spot settings direction > share",
    "select_model: fabric side settings footprint base viewer random > whole positive unit unit unit positive positive "
    "pair "
    "whole whole share share share",
    "transmittance_model: fabric settings tile direction > positive",
    "shading_value: settings weight side spot yarn light viewer > colour positive",
    "direct: settings weight side spot yarn position frame geometric viewer random > whole unit positive colour",
    "direct_matte: albedo position frame geometric viewer random > whole unit positive colour",
    "background: direction > colour",
    "camera_sample: triangle ray fabric settings base random > whole whole whole colour",
};

RowTables make_tables()
{
    RowTables t;
    t.size = {48, 32};
    Draw draw(stream_of("tables"), 0);
    const int count = t.size.x * t.size.y;
    const auto slope_word = [&] {
        const auto half = [&] {
            return static_cast<std::uint32_t>(static_cast<std::int32_t>(std::lround(slope(draw) * 32767 / 4))) &
                   0xffffu;
        };
        const std::uint32_t low = half();
        return low | (half() << 16);
    };
    std::vector<std::uint32_t> shared(static_cast<std::size_t>(count)); // yarn and gap are the same on both sides
    for (std::uint32_t& word : shared)
        word = (static_cast<std::uint32_t>(draw.whole(8)) << 16) | (draw.chance(4) ? 0x800000u : 0u);
    for (int side = 0; side < 2; ++side) {
        for (const std::uint32_t word : shared) {
            const std::uint32_t openness = draw.chance(6)   ? 0
                                           : draw.chance(6) ? 255
                                                            : static_cast<std::uint32_t>(draw.whole(256));
            const std::uint32_t azimuth = draw.chance(6) ? 0 : static_cast<std::uint32_t>(draw.whole(65536));
            t.texels[side].push_back({(word & 0x800000u) != 0 ? 0 : slope_word(), word | azimuth | (openness << 24)});
        }
        for (int k = 0; k < count; ++k) { // as many as caps ask for
            glm::uvec2 knots(0);
            const int pattern = draw.whole(6);
            for (int part_of = 0; part_of < 2 && pattern > 0; ++part_of)
                knots[part_of] =
                    pattern == 1 ? 0xffffffffu
                                 : static_cast<std::uint32_t>(draw.bits()) & (pattern == 2 ? 0xffffffffu : 0x3f3f3f3fu);
            t.horizons[side].push_back(knots);
        }
        for (int level = 1; std::max(t.size.x >> (level - 1), t.size.y >> (level - 1)) > 1; ++level)
            for (int k = 0; k < std::max(t.size.x >> level, 1) * std::max(t.size.y >> level, 1); ++k)
                t.mips[side].push_back(slope_word());
    }
    for (int y = 0; y < t.size.y; ++y) // hills, cliffs and noise
        for (int x = 0; x < t.size.x; ++x) {
            const double hill = 0.5 + 0.4 * std::sin(2 * pi * 3 * x / t.size.x) * std::cos(2 * pi * 2 * y / t.size.y);
            t.heights.push_back(static_cast<std::uint16_t>(
                draw.chance(12) ? 65535 * draw.whole(2)
                                : 65535 * std::clamp(hill + draw.between(-0.1, 0.1), 0.0, 1.0)));
        }
    std::vector<double> numbers(static_cast<std::size_t>(count) * 8);
    Writer asg(numbers.data());
    for (int k = 0; k < count; ++k) {
        asg.put(viewer(draw, {}));
        asg.put(draw.between(-pi, pi));
        asg.put(glm::dvec2(draw.log(0.5, 1e3), draw.log(0.5, 1e3)));
        asg.put(glm::dvec2(draw.log(0.1, 10), 0));
    }
    t.asg.assign(numbers.begin(), numbers.end());
    numbers.resize(8 * row_yarn_numbers);
    Writer yarns(numbers.data());
    for (int k = 0; k < 8; ++k) put_yarn(draw, yarns);
    t.yarns.assign(numbers.begin(), numbers.end());

    const int lights = 49;
    numbers.resize(static_cast<std::size_t>(lights * row_light_numbers));
    Writer writer(numbers.data());
    Context context;
    for (int k = 0; k < lights; ++k)
        put_light(draw, writer, context, k % 7); // the environment, where there is one, comes first
    double total = 0;
    for (int k = 0; k < lights; ++k) total += numbers[static_cast<std::size_t>(k * row_light_numbers + 1)];
    for (int k = 0; k < lights; ++k) numbers[static_cast<std::size_t>(k * row_light_numbers + 1)] /= total;
    t.lights.assign(numbers.begin(), numbers.end());
    t.emitters.assign(emitters().numbers.begin(), emitters().numbers.end());

    t.environment_size = {32, 16};
    std::vector<double> density;
    for (int y = 0; y < t.environment_size.y; ++y)
        for (int x = 0; x < t.environment_size.x; ++x) {
            const Vec radiance = draw.chance(6) ? Vec(0) : Vec(1, draw.share(), draw.share()) * intensity(draw);
            for (int c = 0; c < 3; ++c) t.environment.push_back(static_cast<float>(radiance[c]));
            t.environment.push_back(0);
            density.push_back((radiance.x + radiance.y + radiance.z) * std::sin((y + 0.5) / t.environment_size.y * pi));
        }
    // Equal shares: rows of texels, then the rows, in as many texels as fill a row.
    for (int y = 0; y <= t.environment_size.y; ++y)
        for (int x = 0; x < t.environment_size.x; ++x) {
            const int shares = y < t.environment_size.y ? t.environment_size.x : t.environment_size.y;
            t.inversion.push_back({static_cast<std::uint32_t>((std::uint64_t(x + 1) << 32) / std::uint64_t(shares) - 1),
                                   static_cast<std::uint32_t>(x)});
        }
    double mean = 0;
    for (const double d : density) mean += d / static_cast<double>(density.size());
    for (std::size_t k = 0; k < density.size(); ++k) t.environment[4 * k + 3] = static_cast<float>(density[k] / mean);
    return t;
}

} // namespace

Signature signature_of(std::string_view function, int inputs, int outputs)
{
    for (const std::string_view line : signatures) {
        const std::size_t colon = line.find(": "), arrow = line.find(" > ");
        if (line.substr(0, colon) != function) continue;
        Signature signature{stream_of(function), {}, {}};
        const auto fail = [&](const std::string& what) {
            throw std::runtime_error("tests/cpp/stability_inputs.cpp: the signature of " + std::string(function) + " " +
                                     what);
        };
        const auto words = [](std::string_view text, auto&& take) {
            while (!text.empty()) {
                const std::size_t space = text.find(' ');
                take(text.substr(0, space));
                text = space == std::string_view::npos ? std::string_view() : text.substr(space + 1);
            }
        };
        int in = 0, out = 0;
        words(line.substr(colon + 2, arrow - colon - 2), [&](std::string_view word) {
            if (!kinds().contains(word)) fail("names an unknown kind of argument, " + std::string(word));
            in += kinds().at(word).width;
            signature.inputs.push_back(&kinds().at(word));
        });
        words(line.substr(arrow + 3), [&](std::string_view word) {
            if (!output_kinds().contains(word)) fail("names an unknown kind of result, " + std::string(word));
            signature.outputs.push_back(output_kinds().at(word));
            signature.outputs.back().kind = word;
            out += signature.outputs.back().width;
        });
        if (in != inputs || out != outputs)
            fail("has " + std::to_string(in) + " numbers in and " + std::to_string(out) + " out, the function " +
                 std::to_string(inputs) + " and " + std::to_string(outputs));
        return signature;
    }
    throw std::runtime_error("tests/cpp/stability_inputs.cpp: nobody says what " + std::string(function) +
                             " takes: add its signature, so that it is tested");
}

void draw_inputs(const Signature& signature, std::uint64_t index, double* numbers)
{
    Draw draw(signature.stream, index);
    Writer out(numbers);
    Context context;
    for (const Kind* kind : signature.inputs) kind->draw(draw, out, context);
}

void move_inputs(const Signature& signature, std::uint64_t index, std::uint64_t attempt, int digits,
                 const double* numbers, double* moved)
{
    Draw draw(stream_of("moves") + attempt, index);
    const bool as_vectors = attempt % 2 == 1;
    for (const Kind* kind : signature.inputs) {
        double largest = kind->in_unit_interval ? 1 : 0;
        for (int k = 0; k < kind->width; ++k) largest = std::max(largest, std::abs(numbers[k]));
        // Structs are no vectors: their members stand alone.
        if (kind->width > 3) largest = 0;
        for (int k = 0; k < kind->width; ++k, ++numbers) {
            const double move = draw.between(-1, 1) * std::ldexp(1.0, -digits);
            const bool as_vector = as_vectors && largest > 0;
            double x = *numbers;
            if (kind->measured && as_vector) x += move * largest;
            // A struct's zeros and whole numbers may be kinds.
            else if (kind->measured && x != std::round(x))
                x += move * x;
            if (x * *numbers < 0)
                x = 0.5 * *numbers; // what a function may rely on: signs, and random numbers in [0, 1)
            *moved++ = kind->in_unit_interval ? std::clamp(x, 0.0, 1 - 0x1p-24) : x;
        }
    }
}

} // namespace stability

const RowTables& row_tables()
{
    static const RowTables made = stability::make_tables();
    return made;
}
