// Where the thing is that a pixel of the present frame shows, for finding it again in another view. GLSL only; remember.frag and
// carry.frag include it after scene_buffers.h.

uniform usampler2D seen_map;

struct ShownPlace {
    vec3 at;        // [m]; of the background: unit direction to it
    float object;   // 0 background, else object + 1
    float across;   // extent of a pixel on the surface [m]; of the background 0
};

ShownPlace shown_place(ivec2 xy)
{
    uint object  = texelFetch(seen_map, xy, 0).x, triangle = texelFetch(seen_map, xy, 0).y;
    ClothRay ray = frame_ray(vec2(xy) + 0.5);
    if (object == 0u) return ShownPlace(normalize(ray.direction), 0.0, 0.0);
    ClothSurface surface = cloth_surface(fetch_triangle(fetch_object(int(object) - 1).first_triangle + int(triangle)), ray);
    float pixel = dot(surface.position - ray.origin, frame.camera_forward.xyz) * length(ray.direction_dx);
    return ShownPlace(surface.position, float(object), pixel / max(abs(surface.wo.z), 0.05));
}
