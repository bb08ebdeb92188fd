// Rays against the scene's BVH in buffer textures. GLSL only; roots include it after scene_buffers.h.
//   SHADOWS  something may be in the way of light   GAPS  what is in the way may let light through   BOUNCES  paths go on
//   LAYERS  camera rays go on behind what they pass   CAMERA_RAYS  there is no rasteriser
//   BLOCK_SIDE  of blocks of pixels for which it is known what of the BVH their rays may meet

#if defined(SHADOWS) || defined(BOUNCES) || defined(LAYERS) || defined(CAMERA_RAYS)
uniform usamplerBuffer bvh_nodes;       // RGBA32UI, two texels a node: low xyz, skip | high xyz, leaf: first * 8 + count, 0 inner
uniform usamplerBuffer bvh_triangles;   // RGBA32UI, three texels a triangle, in leaf order: p0, object | e1, triangle | e2, gaps
#ifdef BLOCK_SIDE
uniform isamplerBuffer block_nodes;     // RG32I, row by row: first node, and the one after the last
#endif

// Nodes that a ray may meet: first, and the one after the last. Of any ray:
ivec2 all_nodes()
{
    return ivec2(0, frame.lights.w);
}

// Of the rays of a pixel.
ivec2 nodes_of_pixel(vec2 pixel_centre)
{
#ifdef BLOCK_SIDE
    ivec2 block = ivec2(pixel_centre) / BLOCK_SIDE;
    return texelFetch(block_nodes, block.y * ((int(frame.film.x) + BLOCK_SIDE - 1) / BLOCK_SIDE) + block.x).xy;
#else
    return all_nodes();
#endif
}

// A walk through the tree: what comes next, and the ray. Processors that run many pixels in step (software GL above all, which
// takes every branch) pay for the dear work only as often as it happens where each loop has one kind of work: to the next
// leaf, through its triangles, then what the cloth says to a hit.
struct Walk {
    vec3 origin, direction, inverse;
    int node, last;       // next node, and where they end
    int triangle, end;    // next triangle of the leaf that was entered last
};

Walk begin_walk(vec3 origin, vec3 direction, ivec2 nodes)
{
    return Walk(origin, direction, 1.0 / mix(direction, vec3(1e-20), lessThan(abs(direction), vec3(1e-20))), nodes.x, nodes.y, 0, 0);
}

bool goes_on(Walk walk)
{
    return walk.triangle < walk.end || walk.node < walk.last;
}

// To the next leaf that the ray is in between `near` and `far`, unless the present one has triangles left.
void find_leaf(inout Walk walk, float near, float far)
{
    // Nodes lie in depth-first order: the next one is the first child; a missed node says where its subtree ends.
    while (walk.triangle >= walk.end && walk.node < walk.last) {
        uvec4 low = texelFetch(bvh_nodes, walk.node * 2), high = texelFetch(bvh_nodes, walk.node * 2 + 1);
        vec3 t0 = (uintBitsToFloat(low.xyz) - walk.origin) * walk.inverse, t1 = (uintBitsToFloat(high.xyz) - walk.origin) * walk.inverse;
        // Which is nearer by the direction's sign: min and max look for NaN, which llvmpipe needs three instructions for.
        bvec3 upward = greaterThan(walk.inverse, vec3(0.0));
        vec3 nearer  = mix(t1, t0, upward), further = mix(t0, t1, upward);
        float enter = max(max(nearer.x, nearer.y), max(nearer.z, near)), leave = min(min(further.x, further.y), min(further.z, far));
        bool inside = enter <= leave * 1.0000004;
        bool leaf   = inside && high.w != 0u;
        walk.triangle = leaf ? int(high.w >> 3u) : walk.triangle;
        walk.end      = leaf ? walk.triangle + int(high.w & 7u) : walk.end;
        walk.node     = inside && !leaf ? walk.node + 1 : int(low.w);
    }
}

// Where the ray meets the next triangle of the leaf.
//   at      gets object, triangle, gaps
//   return  b1, b2, distance; infinities or no numbers, which meet nothing, in the triangle's plane
vec3 next_triangle(inout Walk walk, out uvec3 at)
{
    // Moeller & Trumbore 1997
    uvec4 w0 = texelFetch(bvh_triangles, walk.triangle * 3), w1 = texelFetch(bvh_triangles, walk.triangle * 3 + 1);
    uvec4 w2 = texelFetch(bvh_triangles, walk.triangle * 3 + 2);
    vec3 e1  = uintBitsToFloat(w1.xyz), e2 = uintBitsToFloat(w2.xyz);
    vec3 p   = cross(walk.direction, e2);
    vec3 s   = walk.origin - uintBitsToFloat(w0.xyz);
    vec3 q   = cross(s, e1);
    at       = uvec3(w0.w, w1.w, w2.w);
    ++walk.triangle;
    return vec3(dot(s, p), dot(walk.direction, q), dot(e2, q)) / dot(e1, p);
}

bool is_between(vec3 t, float near, float far)
{
    return t.x >= 0.0 && t.y >= 0.0 && t.x + t.y <= 1.0 && t.z > near && t.z < far;
}
#endif

#if defined(BOUNCES) || defined(LAYERS) || defined(CAMERA_RAYS)
struct Hit {
    int object;      // -1: none
    int triangle;
    float distance;
};

// The nearest triangle beyond a hit that the ray has passed, distances in lengths of its direction: Hit(-1, -1, 0.0) at its start. A triangle is not met twice.
Hit closest(vec3 origin, vec3 direction, ivec2 nodes, Hit passed)
{
    Hit hit   = Hit(-1, -1, cloth_far);
    Walk walk = begin_walk(origin, direction, nodes);
    while (goes_on(walk)) {
        find_leaf(walk, passed.distance, hit.distance);
        while (walk.triangle < walk.end) {
            uvec3 at;
            vec3 t = next_triangle(walk, at);
            if (is_between(t, passed.distance, hit.distance) && ivec2(at.xy) != ivec2(passed.object, passed.triangle))
                hit = Hit(int(at.x), int(at.y), t.z);
        }
    }
    return hit;
}
#endif

#ifdef SHADOWS
// Share of the light that crosses the cloth where a ray hits it at barycentrics b (b1, b2).
float share_at(int object_index, int triangle_index, vec2 b, vec3 direction)
{
    SceneObject object     = fetch_object(object_index);
    ClothTriangle triangle = fetch_triangle(object.first_triangle + triangle_index);
    vec2 tile = triangle.t0 + (triangle.t1 - triangle.t0) * b.x + (triangle.t2 - triangle.t0) * b.y;
    ClothFacet facet = cloth_facet(triangle);
    return cloth_transmittance(object.maps, tile, cloth_to_local(cloth_uv_frame(facet, facet.normal), direction), frame_settings());
}

// Share of the light that gets from origin to origin + distance * direction (unit).
//   least, u  of the ray's roulette
float transmittance(vec3 origin, vec3 direction, float distance, float least, float u)
{
    ClothShare share = cloth_shadow_roulette(ClothShare(1.0, u), least);
    Walk walk    = begin_walk(origin, direction, all_nodes());
    bool walking = share.left > 0.0;
    while (walking) {
        bool hit = false;
        vec2 b   = vec2(0.0);
        uvec3 at = uvec3(0u);
        while (!hit && goes_on(walk)) {
            find_leaf(walk, 0.0, distance);
            while (walk.triangle < walk.end && !hit) {
                vec3 t = next_triangle(walk, at);
                hit    = is_between(t, 0.0, distance);
                b      = t.xy;
            }
        }
#ifdef GAPS
        if (hit) {
            share.left *= at.z == 0u ? 0.0 : share_at(int(at.x), int(at.y), b, direction);
            share = cloth_shadow_roulette(share, least);
        }
        walking = hit && share.left > 0.0;
#else
        share.left = hit ? 0.0 : share.left;
        walking    = false;
#endif
    }
    return share.left;
}
#else
float transmittance(vec3 origin, vec3 direction, float distance, float least, float u)
{
    return 1.0;
}
#endif
