// Shadow rays against the scene's BVH in buffer textures. GLSL only; roots include it after scene_buffers.h.
//   SHADOWS  something may be in the way   GAPS  what is in the way may let light through

#ifdef SHADOWS
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
//
// Loops within loops, each with one kind of work: to the next leaf, through its triangles, then what the cloth says to a hit.
// Processors that run many pixels in step (software GL above all, which takes every branch) pay for the dear work only as
// often as it happens, not at each step of the walk.
float transmittance(vec3 origin, vec3 direction, float distance)
{
    float share = 1.0;
    vec3 inverse = 1.0 / mix(direction, vec3(1e-20), lessThan(abs(direction), vec3(1e-20)));
    int node = 0, triangle = 0, end = 0;   // next node; next triangle of the leaf that was entered last
    bool walking = true;
    while (walking) {
        bool hit = false;
        vec2 b   = vec2(0.0);
        uvec3 at = uvec3(0u);   // object, triangle, gaps
        while (!hit && (triangle < end || node < frame.lights.w)) {
            // Nodes lie in depth-first order: the next one is the first child; a missed node says where its subtree ends.
            while (triangle >= end && node < frame.lights.w) {
                uvec4 low = texelFetch(bvh_nodes, node * 2), high = texelFetch(bvh_nodes, node * 2 + 1);
                vec3 t0 = (uintBitsToFloat(low.xyz) - origin) * inverse, t1 = (uintBitsToFloat(high.xyz) - origin) * inverse;
                vec3 near = min(t0, t1), far = max(t0, t1);
                float enter = max(max(near.x, near.y), max(near.z, 0.0)), leave = min(min(far.x, far.y), min(far.z, distance));
                bool inside = enter <= leave * 1.0000004;
                bool leaf   = inside && high.w != 0u;
                triangle = leaf ? int(high.w >> 3u) : triangle;
                end      = leaf ? triangle + int(high.w & 7u) : end;
                node     = inside && !leaf ? node + 1 : int(low.w);
            }
            while (triangle < end && !hit) {
                // Moeller & Trumbore 1997
                uvec4 w0 = texelFetch(bvh_triangles, triangle * 3), w1 = texelFetch(bvh_triangles, triangle * 3 + 1);
                uvec4 w2 = texelFetch(bvh_triangles, triangle * 3 + 2);
                vec3 e1  = uintBitsToFloat(w1.xyz), e2 = uintBitsToFloat(w2.xyz);
                vec3 p   = cross(direction, e2);
                vec3 s   = origin - uintBitsToFloat(w0.xyz);
                vec3 q   = cross(s, e1);
                float determinant = dot(e1, p);
                vec3 t   = vec3(dot(s, p), dot(direction, q), dot(e2, q)) / determinant;   // b1, b2, distance
                // A ray in the triangle's plane makes infinities or no numbers, which miss.
                hit = t.x >= 0.0 && t.y >= 0.0 && t.x + t.y <= 1.0 && t.z > 0.0 && t.z < distance;
                b   = t.xy;
                at  = uvec3(w0.w, w1.w, w2.w);
                ++triangle;
            }
        }
#ifdef GAPS
        if (hit) share *= at.z == 0u ? 0.0 : share_at(int(at.x), int(at.y), b, direction);
        walking = hit && share > 0.0;
#else
        share   = hit ? 0.0 : 1.0;
        walking = false;
#endif
    }
    return share;
}
#else
float transmittance(vec3 origin, vec3 direction, float distance)
{
    return 1.0;
}
#endif
