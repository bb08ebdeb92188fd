// Stands in for glsl/shade.frag in suite preview: matte under one point light without shadows, written by hand for that and nothing
// else. What a program with everything off is held to, so it draws every scene that such a program draws: several objects, seen from
// either side or beside, with shading normals that face away from the viewer or the light, with a light at no distance.
#include "interop.h"
#include "blocks.h"

uniform usampler2D id_map;
uniform samplerBuffer triangle_table;
uniform samplerBuffer light_table;
uniform usamplerBuffer object_table;
layout(location = 0) out vec4 colour;
layout(location = 1) out uvec2 seen;

void main()
{
    uvec2 id = texelFetch(id_map, ivec2(gl_FragCoord.xy), 0).xy;
    seen = id;
    if (id.x == 0u) {
        colour = vec4(0.0);
        return;
    }
    vec2 ndc = 2.0 * (gl_FragCoord.xy + frame.film.zw) / frame.film.xy - 1.0;
    vec3 direction = frame.camera_forward.xyz + frame.camera_right.xyz * (ndc.x + frame.lens.x) - frame.camera_up.xyz * (ndc.y - frame.lens.y);
    int object = (int(id.x) - 1) * 5;
    int base   = (int(texelFetch(object_table, object).x) + int(id.y)) * 6;
    vec3 p0 = texelFetch(triangle_table, base).xyz;
    vec3 e1 = texelFetch(triangle_table, base + 1).xyz - p0, e2 = texelFetch(triangle_table, base + 2).xyz - p0;
    vec3 n  = cross(e1, e2);
    float n2 = dot(n, n);
    vec3 front = n2 > 0.0 ? n * inversesqrt(n2) : vec3(0.0, 0.0, 1.0);
    float facing = dot(front, direction), divisor = abs(facing) < 1e-12 ? 1e-12 : facing;
    vec3 d  = frame.camera_position.xyz + direction * (dot(p0 - frame.camera_position.xyz, front) / divisor) - p0;
    vec2 b  = n2 > 0.0 ? clamp(vec2(dot(cross(d, e2), n), dot(cross(e1, d), n)) / n2, vec2(0.0), vec2(1.0)) : vec2(1.0 / 3.0);
    vec3 p  = p0 + e1 * b.x + e2 * b.y;
    vec3 normal = texelFetch(triangle_table, base + 3).xyz * (1.0 - b.x - b.y) + texelFetch(triangle_table, base + 4).xyz * b.x +
                  texelFetch(triangle_table, base + 5).xyz * b.y;
    float length2 = dot(normal, normal), side = facing > 0.0 ? -1.0 : 1.0;
    normal = length2 > 0.0 ? normal * inversesqrt(length2) : front;
    if (dot(normal, front) < 0.0) normal = -normal;
    if (-dot(normal, direction) * inversesqrt(dot(direction, direction)) * side <= 1e-4) normal = front;
    vec3 to       = texelFetch(light_table, 0).xyz - p;
    float dist2   = dot(to, to), cosine = dot(normal, to) * side;
    bool lit      = dist2 > 1e-20 && cosine > 0.0 && dot(front, to) * side > 0.0;
    vec3 albedo   = uintBitsToFloat(texelFetch(object_table, object + 2).xyz);
    vec3 radiance = albedo * texelFetch(light_table, 2).xyz * (cosine / (3.14159265 * dist2 * sqrt(dist2)));
    bool good     = lit && all(greaterThanEqual(radiance, vec3(0.0))) && all(lessThan(radiance, vec3(1e30)));
    colour        = vec4(good ? radiance : vec3(0.0), 1.0);
}
