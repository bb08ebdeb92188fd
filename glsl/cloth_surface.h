// From camera and triangle to the surface that is shaded: position, frame, UV and its exact derivatives. Shared;
// imports cloth_bsdf.h.

struct ClothCamera {
    real3 position;   // [m]
    real3 forward;    // unit
    real3 right;      // unit times tan(half horizontal field of view)
    real3 up;         // unit times tan(half vertical field of view)
    real2 resolution; // [px]
};

// A ray and how its direction changes per pixel. The direction is not unit: its forward component is 1.
struct ClothRay {
    real3 origin;
    real3 direction;
    real3 direction_dx;
    real3 direction_dy;
};

struct ClothTriangle {
    real3 p0;   // [m], world
    real3 p1;
    real3 p2;
    real3 n0;   // vertex normals, any length
    real3 n1;
    real3 n2;
    real2 t0;   // UV in tiles of the fabric
    real2 t1;
    real2 t2;
};

struct ClothSurface {
    real3 position;     // [m], world
    real3 normal_g;     // unit geometric normal on the viewer's side
    ClothFrame frame;   // local frame: z the shading normal on the viewer's side, x along +u, y along +v
    real3 wo;           // local, to the viewer, wo.z > 0
    real2 tile;         // UV in tiles
    real2 tile_dx;      // change per pixel in x and y
    real2 tile_dy;
    int side;           // 0: seen from the front (counter-clockwise), 1: from behind
};

// A thin lens: what its plane at a distance along `forward` shows is sharp.
struct ClothLens {
    real radius;     // [m]; 0: a pinhole
    real distance;   // of the plane in focus [m], > 0
};

// The pinhole camera that one point of the lens is. Its `forward` is no longer unit, but its component along the old one
// stays 1; a camera with radius 0 stays as it is, bit for bit.
//   source  Cook, Porter & Carpenter 1984, "Distributed ray tracing"
//   u       [0, 1)^2, point of the lens, uniform
CLOTH_FN ClothCamera cloth_lens_camera(ClothCamera camera, ClothLens lens, real2 u)
{
    if (!(lens.radius > real(0))) return camera;
    real r = lens.radius * sqrt(u.x), phi = real(2) * cloth_pi * u.y;
    real3 offset = normalize(camera.right) * (r * cos(phi)) + normalize(camera.up) * (r * sin(phi));
    camera.position = camera.position + offset;
    camera.forward  = camera.forward - offset / lens.distance;
    return camera;
}

// Ray through raster position (px, py), pixel (0, 0) at the top left.
CLOTH_FN ClothRay cloth_camera_ray(CLOTH_IN(ClothCamera) camera, real2 raster)
{
    real x = real(2) * raster.x / camera.resolution.x - real(1);
    real y = real(1) - real(2) * raster.y / camera.resolution.y;
    return ClothRay(camera.position, camera.forward + camera.right * x + camera.up * y,
                    camera.right * (real(2) / camera.resolution.x), camera.up * (real(-2) / camera.resolution.y));
}

// Pixel filters, importance sampled: offset from the pixel centre in pixels for u in [0, 1)^2.
CLOTH_CONST int cloth_filter_box  = 0;   // one pixel wide
CLOTH_CONST int cloth_filter_tent = 1;   // two pixels wide
CLOTH_FN real2 cloth_filter_offset(int kind, real2 u)
{
    if (kind == cloth_filter_box) return u - real2(real(0.5), real(0.5));
    real x = u.x < real(0.5) ? sqrt(real(2) * u.x) - real(1) : real(1) - sqrt(real(2) - real(2) * u.x);
    real y = u.y < real(0.5) ? sqrt(real(2) * u.y) - real(1) : real(1) - sqrt(real(2) - real(2) * u.y);
    return real2(x, y);
}

// Barycentric coordinates (b1, b2) of a point's projection on the triangle's plane; (1/3, 1/3) where it has no area.
CLOTH_FN real2 cloth_barycentric(ClothTriangle triangle, real3 point)
{
    real3 e1 = triangle.p1 - triangle.p0, e2 = triangle.p2 - triangle.p0;
    real3 n  = cross(e1, e2);
    real n2  = dot(n, n);
    if (n2 <= real(0)) return real2(real(1) / real(3), real(1) / real(3));
    real3 d  = point - triangle.p0;
    return real2(dot(cross(d, e2), n) / n2, dot(cross(e1, d), n) / n2);
}

// What of a flat triangle is the same for every ray that meets it.
struct ClothFacet {
    real3 e1;       // p1 - p0, p2 - p0 [m]
    real3 e2;
    real3 normal;   // unit, of the front
    bool area;      // false: it has none
    real3 grad1;    // gradients of the barycentric coordinates in its plane [1/m]
    real3 grad2;
    real2 dt1;      // t1 - t0, t2 - t0
    real2 dt2;
    real3 dp_u;     // along +u, any length
    real hand;      // +1 or -1: (x, y, normal) of the yarns is right-handed or not; 0: no direction of yarns, for want of UV area
};

// Mirrored UVs mirror the fabric: y follows +v. The UV winding is judged against the geometric winding.
CLOTH_FN ClothFacet cloth_facet(CLOTH_IN(ClothTriangle) triangle)
{
    ClothFacet f;
    f.e1       = triangle.p1 - triangle.p0;
    f.e2       = triangle.p2 - triangle.p0;
    real3 n    = cross(f.e1, f.e2);
    f.normal   = cloth_unit_vector(n * (real(1) / (abs(n.x) + abs(n.y) + abs(n.z) + real(1e-30))), real3(real(0), real(0), real(1)));
    real n2    = dot(n, n);
    real per_n2 = real(1) / max(n2, real(1e-38));
    f.area     = n2 > real(0);
    f.grad1    = cross(f.e2, n) * per_n2;
    f.grad2    = cross(n, f.e1) * per_n2;
    f.dt1      = triangle.t1 - triangle.t0;
    f.dt2      = triangle.t2 - triangle.t0;
    real det   = f.dt1.x * f.dt2.y - f.dt2.x * f.dt1.y;
    real turn  = det < real(0) ? real(-1) : real(1);   // of dp/du and dp/dv only the direction counts
    f.dp_u     = (f.e1 * f.dt2.y - f.e2 * f.dt1.y) * turn;
    real3 dp_v = (f.e2 * f.dt1.x - f.e1 * f.dt2.x) * turn;
    f.hand     = det == real(0) ? real(0) : dot(cross(f.dp_u, dp_v), f.normal) < real(0) ? real(-1) : real(1);
    return f;
}

// Frame of the yarns about a shading normal of the front.
CLOTH_FN ClothFrame cloth_uv_frame(CLOTH_IN(ClothFacet) facet, real3 normal_front)
{
    real3 x   = facet.dp_u - normal_front * dot(normal_front, facet.dp_u);
    real len2 = dot(x, x);
    // Without a direction of yarns any frame will do, but always the same one. Nearly along the normal there is none either: what
    // rounding leaves of it is not perpendicular any more.
    if (!(len2 > real(1e-6) * dot(facet.dp_u, facet.dp_u)) || facet.hand == real(0)) return cloth_frame(normal_front);
    x = x * (real(1) / sqrt(len2));
    return ClothFrame(x, cross(normal_front, x) * facet.hand, normal_front);
}

// The surface where a camera ray meets a triangle. The caller knows that it does (raster or BVH).
CLOTH_FN ClothSurface cloth_surface(CLOTH_IN(ClothTriangle) triangle, CLOTH_IN(ClothFacet) facet, CLOTH_IN(ClothRay) ray)
{
    real facing     = dot(facet.normal, ray.direction);
    real per_facing = (facing < real(0) ? real(-1) : real(1)) / max(abs(facing), real(1e-12));
    real t          = dot(triangle.p0 - ray.origin, facet.normal) * per_facing;
    real3 d      = ray.origin + ray.direction * t - triangle.p0;
    real2 b      = facet.area ? real2(dot(d, facet.grad1), dot(d, facet.grad2)) : real2(real(1) / real(3), real(1) / real(3));
    b            = clamp(b, real2(real(0), real(0)), real2(real(1), real(1)));
    real b0      = real(1) - b.x - b.y;

    ClothSurface s;
    s.position = triangle.p0 + facet.e1 * b.x + facet.e2 * b.y;
    s.tile     = triangle.t0 + facet.dt1 * b.x + facet.dt2 * b.y;

    // Exact derivatives: the ray of the neighbouring pixel meets the same plane (Igehy 1999).
    real3 p_dx   = (ray.direction_dx - ray.direction * (dot(ray.direction_dx, facet.normal) * per_facing)) * t;
    real3 p_dy   = (ray.direction_dy - ray.direction * (dot(ray.direction_dy, facet.normal) * per_facing)) * t;
    // One tile either way is as much as a footprint can tell: beyond, every point of the tile is equally likely [hazard 18].
    s.tile_dx = clamp(facet.dt1 * dot(facet.grad1, p_dx) + facet.dt2 * dot(facet.grad2, p_dx), real2(real(-64), real(-64)), real2(real(64), real(64)));
    s.tile_dy = clamp(facet.dt1 * dot(facet.grad1, p_dy) + facet.dt2 * dot(facet.grad2, p_dy), real2(real(-64), real(-64)), real2(real(64), real(64)));

    real3 wo   = -normalize(ray.direction);
    s.side     = facing > real(0) ? 1 : 0;
    real flip  = s.side == 1 ? real(-1) : real(1);
    s.normal_g = facet.normal * flip;
    real3 n_s  = cloth_unit_vector(triangle.n0 * b0 + triangle.n1 * b.x + triangle.n2 * b.y, facet.normal);
    if (dot(n_s, facet.normal) < real(0)) n_s = -n_s;
    // A shading normal that faces away from the viewer says nothing: the geometric one takes its place [hazard 23].
    if (dot(n_s, wo) * flip <= real(1e-4)) n_s = facet.normal;
    s.frame   = cloth_uv_frame(facet, n_s);
    s.frame.z = s.frame.z * flip;
    s.wo      = cloth_to_local(s.frame, wo);
    s.wo.z    = max(s.wo.z, real(1e-6));
    return s;
}

CLOTH_FN ClothSurface cloth_surface(CLOTH_IN(ClothTriangle) triangle, CLOTH_IN(ClothRay) ray)
{
    return cloth_surface(triangle, cloth_facet(triangle), ray);
}

// Start of a ray that leaves the surface on the side of n: moved off it by more than the rounding of its position.
CLOTH_FN real3 cloth_leave(real3 position, real3 n)
{
    real scale = max(max(abs(position.x), abs(position.y)), max(abs(position.z), real(1e-3)));
    return position + n * (scale * real(2e-5));
}
