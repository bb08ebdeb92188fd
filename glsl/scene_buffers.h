// The scene in buffer textures, and the frame's camera, lights and random numbers. GLSL only; roots include it after
// interop.h, cloth.h and blocks.h. Written by app/preview/preview.cpp.

uniform samplerBuffer triangle_table;    // RGBA32F, six texels a triangle: p0 t0.x | p1 t0.y | p2 t1.x | n0 t1.y | n1 t2.x | n2 t2.y
uniform usamplerBuffer object_table;     // RGBA32UI, five texels an object

uniform isamplerBuffer tile_base_table;  // RG32I, one texel a triangle: whole repeats, for the twist noise

struct SceneObject {
    int first_triangle;   // in triangle_table
    bool matte;
    bool gaps;            // rays may pass through
    vec3 albedo;          // matte only, likewise:
    float roughness;      // of metal; 0: none
    int light;            // that the object is; -1: it does not shine
    ClothMaps maps;       // fabric only
};

SceneObject fetch_object(int index)
{
    int base = index * 5;
    ivec4 a = ivec4(texelFetch(object_table, base)), b = ivec4(texelFetch(object_table, base + 1));
    uvec4 c = texelFetch(object_table, base + 2);
    vec4 d  = uintBitsToFloat(texelFetch(object_table, base + 3));
    uvec4 e = texelFetch(object_table, base + 4);
    bool matte = (a.y & 1) == 0;
    float last = uintBitsToFloat(c.w);   // roughness, or amplitude of a fabric's noise
    return SceneObject(a.x, matte, (a.y & 2) != 0, uintBitsToFloat(c.xyz), matte ? last : 0.0, matte ? a.w - 1 : -1,
                       ClothMaps(b.xy, b.z, b.w, ivec2(c.yz), int(c.x), a.z, a.w, uintBitsToFloat(e.xy), d.xy, d.zw, ivec2(e.zw), last));
}

ClothTriangle fetch_triangle(int index)
{
    int base = index * 6;
    vec4 a = texelFetch(triangle_table, base), b = texelFetch(triangle_table, base + 1), c = texelFetch(triangle_table, base + 2);
    vec4 d = texelFetch(triangle_table, base + 3), e = texelFetch(triangle_table, base + 4), f = texelFetch(triangle_table, base + 5);
    return ClothTriangle(a.xyz, b.xyz, c.xyz, d.xyz, e.xyz, f.xyz, vec2(a.w, b.w), vec2(c.w, d.w), vec2(e.w, f.w));
}

ivec2 fetch_tile_base(SceneObject object, int triangle)
{
    return MODEL_TWIST_NOISE != 0 ? texelFetch(tile_base_table, object.first_triangle + triangle).xy : ivec2(0);
}

// Row 0 of the framebuffer is the top row of the picture, so that gl_FragCoord is the raster position.
ClothRay frame_ray(vec2 pixel_centre)
{
    vec3 right = frame.camera_right.xyz, up = frame.camera_up.xyz;
    ClothCamera camera = ClothCamera(frame.camera_position.xyz, frame.camera_forward.xyz + right * frame.lens.x + up * frame.lens.y,
                                     right, up, frame.film.xy);
    return cloth_camera_ray(camera, pixel_centre + frame.film.zw);
}

ClothSettings frame_settings()
{
    return ClothSettings(MODEL_BSDF, MODEL_WEIGHT, MODEL_VISIBILITY, MODEL_SLAB, MODEL_UNSCATTERED != 0, MODEL_INTERREFLECTION != 0,
                         MODEL_TWIST_NOISE != 0);
}

ClothLights frame_lights()
{
#ifdef FEW_LIGHTS
    return ClothLights(LIGHT_COUNT, frame.lights.yz);
#else
    return ClothLights(frame.lights.x, frame.lights.yz);
#endif
}

// Radiance and coverage where a ray meets nothing.
vec4 background(ClothRay ray)
{
    return vec4(cloth_background(frame_lights(), normalize(ray.direction)), 0.0);
}

uint pixel_seed(vec2 pixel_centre)
{
    uvec2 pixel = uvec2(pixel_centre);
    return cloth_hash_combine(frame.random.x, pixel.y * uint(frame.film.x) + pixel.x);
}

// Random numbers of one layer for one sample of a pixel.
ClothRandom layer_random(ClothRandom random, int object, int triangle)
{
    random.seed = cloth_hash_combine(cloth_hash_combine(random.seed, uint(object)), uint(triangle));
    return random;
}

ClothFootprint footprint_on(SceneObject object, int triangle, ClothSurface surface)
{
    return ClothFootprint(surface.tile, surface.tile_dx, surface.tile_dy, fetch_tile_base(object, triangle));
}

// The visibility pass has to find a point of every cloth with gaps; the shade pass takes it from there, in two words: spot
// with the top bit set, repeat (16 bits each; where a triangle has more repeats, float has lost their texels anyway). Not where
// the model weighs points by area, which has no room: those are found again.
//   FOUND  a point of every fabric is handed over
uvec2 hand_over(ClothPlace place)
{
    if (cloth_weighs_areas(frame_settings())) return uvec2(0u);
    return uvec2(0x80000000u | uint(place.spot.y << 16) | uint(place.spot.x), uint(place.repeat.y << 16) | (uint(place.repeat.x) & 0xffffu));
}

bool handed_over(uvec2 words)
{
#ifdef FOUND
    return true;
#else
    return (words.x & 0x80000000u) != 0u;
#endif
}

ClothPlace take_over(uvec2 words)
{
    return ClothPlace(ivec2(words.x & 0xffffu, (words.x >> 16u) & 0x7fffu), ivec2(int(words.y << 16u) >> 16, int(words.y) >> 16), 1.0);
}
