// Stands in for glsl/shade.frag in suite preview: matte under one point light without shadows, written by hand with nothing else in it.
// What a program with everything off is held to.
#include "interop.h"
#include "blocks.h"

uniform usampler2D id_map;
uniform samplerBuffer triangle_table;
uniform samplerBuffer light_table;
uniform usamplerBuffer object_table;
layout(location = 0) out vec4 colour;

void main()
{
    uint triangle = texelFetch(id_map, ivec2(gl_FragCoord.xy), 0).y;
    vec2 ndc = 2.0 * (gl_FragCoord.xy + frame.film.zw) / frame.film.xy - 1.0;
    vec3 direction = frame.camera_forward.xyz + frame.camera_right.xyz * ndc.x - frame.camera_up.xyz * ndc.y;
    int base = int(triangle) * 6;
    vec3 p0 = texelFetch(triangle_table, base).xyz, p1 = texelFetch(triangle_table, base + 1).xyz, p2 = texelFetch(triangle_table, base + 2).xyz;
    vec3 n  = normalize(cross(p1 - p0, p2 - p0));
    vec3 p  = frame.camera_position.xyz + direction * (dot(p0 - frame.camera_position.xyz, n) / dot(direction, n));
    vec3 b  = vec3(0.0);
    vec3 n2 = cross(p1 - p0, p2 - p0);
    b.y = dot(cross(p - p0, p2 - p0), n2) / dot(n2, n2);
    b.z = dot(cross(p1 - p0, p - p0), n2) / dot(n2, n2);
    b.x = 1.0 - b.y - b.z;
    vec3 normal = normalize(texelFetch(triangle_table, base + 3).xyz * b.x + texelFetch(triangle_table, base + 4).xyz * b.y +
                            texelFetch(triangle_table, base + 5).xyz * b.z);
    vec3 to     = texelFetch(light_table, 0).xyz - p;
    float dist2 = dot(to, to);
    vec3 albedo = uintBitsToFloat(texelFetch(object_table, 3).xyz);
    colour = vec4(albedo * texelFetch(light_table, 2).xyz * (max(dot(normal, to), 0.0) / (3.14159265 * dist2 * sqrt(dist2))), 1.0);
}
