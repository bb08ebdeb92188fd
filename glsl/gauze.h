// Whether a camera ray passes cloth with gaps. GLSL only; visibility.frag includes it after
// scene_buffers.h.

//   index, triangle  what the ray meets, of the object `object`
//   found            gets the point of the cloth that it meets there: hand_over
bool passes_gauze(SceneObject object, int index, int triangle, ClothRay ray, vec2 pixel_centre, out uvec2 found)
{
    ClothSurface surface     = cloth_surface(fetch_triangle(object.first_triangle + triangle), ray);
    ClothRandom random       = layer_random(ClothRandom(pixel_seed(pixel_centre), frame.random.y, 0u), index, triangle);
    ClothFootprint footprint = footprint_on(object, triangle, surface);
    vec2 u                   = cloth_draw(random, cloth_dim_pick);
    ClothPlace place         = cloth_find(object.maps, surface.side, footprint, surface.wo, frame_settings(), random, u.x);
    found                    = hand_over(place);
    return cloth_reach(object.maps, surface.side, footprint, place, surface.wo, frame_settings(), u.y, false).passes;
}
