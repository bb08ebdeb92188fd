// Shadow rays against the scene's BVH in buffer textures. GLSL only; roots include it after scene_buffers.h.

uniform usamplerBuffer bvh_nodes;       // RGBA32UI, two texels a node: low xyz, skip | high xyz, leaf: first * 8 + count, 0 inner
uniform usamplerBuffer bvh_triangles;   // RGBA32UI, three texels a triangle, in leaf order: p0, object | e1, triangle | e2, gaps

// Share of the light that crosses the cloth where a ray hits it at barycentrics b (b1, b2).
float share_at(int object_index, int triangle_index, vec2 b, vec3 direction)
{
    SceneObject object     = fetch_object(object_index);
    ClothTriangle triangle = fetch_triangle(object.first_triangle + triangle_index);
    vec2 tile = triangle.t0 + (triangle.t1 - triangle.t0) * b.x + (triangle.t2 - triangle.t0) * b.y;
    vec3 n    = normalize(cross(triangle.p1 - triangle.p0, triangle.p2 - triangle.p0));
    return cloth_transmittance(object.maps, tile, cloth_to_local(cloth_uv_frame(triangle, n, n), direction), frame_settings());
}

// Share of the light that gets from origin to origin + distance * direction (unit).
float transmittance(vec3 origin, vec3 direction, float distance)
{
    float share = 1.0;
    vec3 inverse = 1.0 / mix(direction, vec3(1e-20), lessThan(abs(direction), vec3(1e-20)));
    int node = 0;
    // Nodes lie in depth-first order: the next one is the first child; a missed node says where its subtree ends.
    while (node < frame.lights.w) {
        uvec4 a = texelFetch(bvh_nodes, node * 2), b = texelFetch(bvh_nodes, node * 2 + 1);
        vec3 t0 = (uintBitsToFloat(a.xyz) - origin) * inverse, t1 = (uintBitsToFloat(b.xyz) - origin) * inverse;
        vec3 near = min(t0, t1), far = max(t0, t1);
        float enter = max(max(near.x, near.y), max(near.z, 0.0)), leave = min(min(far.x, far.y), min(far.z, distance));
        if (enter > leave * 1.0000004) {
            node = int(a.w);
            continue;
        }
        if (b.w == 0u) {
            ++node;
            continue;
        }
        int first = int(b.w >> 3u), end = first + int(b.w & 7u);
        for (int k = first; k < end; ++k) {
            // Moeller & Trumbore 1997
            uvec4 w0 = texelFetch(bvh_triangles, k * 3), w1 = texelFetch(bvh_triangles, k * 3 + 1), w2 = texelFetch(bvh_triangles, k * 3 + 2);
            vec3 e1 = uintBitsToFloat(w1.xyz), e2 = uintBitsToFloat(w2.xyz);
            vec3 p  = cross(direction, e2);
            float determinant = dot(e1, p);
            if (determinant == 0.0) continue;
            vec3 s  = origin - uintBitsToFloat(w0.xyz);
            vec3 q  = cross(s, e1);
            vec3 hit = vec3(dot(s, p), dot(direction, q), dot(e2, q)) / determinant;   // b1, b2, distance
            if (hit.x < 0.0 || hit.y < 0.0 || hit.x + hit.y > 1.0 || hit.z <= 0.0 || hit.z >= distance) continue;
#ifdef GAPS
            if (w2.w != 0u) {
                share *= share_at(int(w0.w), int(w1.w), hit.xy, direction);
                if (share > 0.0) continue;
            }
#endif
            return 0.0;
        }
        node = int(a.w);
    }
    return share;
}
