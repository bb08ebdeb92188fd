// One row for each shared function under test: ROW(name, numbers in, numbers out, statements). The statements are in the dialect
// of glsl/interop.h, so one text runs as GLSL (tests/evaluate.py pastes it into evaluate.comp), C++ float and C++ double
// (cpp/evaluate_main.cpp). What goes in, what is expected and how exactly: shared_functions.py, by the same name.

// ---- cloth_bsdf.h
ROW(frame, 3, 9, out_frame(0, cloth_frame(in3(0)));)
ROW(unit_vector, 6, 3, out3(0, cloth_unit_vector(in3(0), in3(3)));)
ROW(sggx_sigma, 7, 1, out1(0, cloth_sggx_sigma(in3(0), in3(3), in1(6)));)
ROW(sggx_d, 7, 1, out1(0, cloth_sggx_d(in3(0), in3(3), in1(6)));)
ROW(sggx_d_antiparallel, 7, 1, out1(0, cloth_sggx_d_antiparallel(in3(0), in3(3), in1(6)));)
ROW(sggx_d_half, 10, 1, out1(0, cloth_sggx_d_half(in3(0), in3(3), in3(6), in1(9)));)
ROW(sggx_sample_vndf, 9, 3, out3(0, cloth_sggx_sample_vndf(in3(0), in3(3), in1(6), in2(7)));)
ROW(phi1, 1, 1, out1(0, cloth_phi1(in1(0)));)
ROW(slab_reflect, 6, 1, out1(0, cloth_slab_reflect(in1(0), in1(1), in1(2), in1(3), in1(4), in1(5)));)
ROW(slab_transmit, 6, 1, out1(0, cloth_slab_transmit(in1(0), in1(1), in1(2), in1(3), in1(4), in1(5)));)
ROW(diffuse, 7, 1, out1(0, cloth_diffuse(in3(0), in3(3), in1(6)));)
ROW(point_value, 35, 3, out3(0, cloth_point_value(in_point(0), in_yarn(11), in3(28), in3(31), in_int(34)));)
ROW(unscattered, 32, 1, ClothYarn y = in_yarn(11); y.beneath = in1(31); ClothPoint p = in_point(0); out1(0, cloth_unscattered(y, p.normal_f, p.tangent, in3(28)));)
ROW(interreflection, 5, 6, ClothRegained r = cloth_interreflection(in3(0), in2(3)); out3(0, r.front); out3(3, r.back);)
ROW(lobe_weights, 17, 4, real4 w = cloth_lobe_weights(in_yarn(0)); out2(0, real2(w.x, w.y)); out2(2, real2(w.z, w.w));)
ROW(point_pdf, 34, 1, out1(0, cloth_point_pdf(in_point(0), in_yarn(11), in3(28), in3(31)));)
ROW(cosine_sample, 5, 3, out3(0, cloth_cosine_sample(in3(0), in2(3)));)
ROW(point_sample, 35, 4, ClothSample s = cloth_point_sample(in_point(0), in_yarn(11), in3(28), in2(31), in2(33)); out3(0, s.wi); out1(3, s.pdf);)
ROW(point_beneath, 43, 8, ClothPoint p = in_point(0); p.tangent_t = in3(35); ClothYarn y = in_yarn(11); y.thickness_t = in1(38); out3(0, cloth_point_value(p, y, in3(28), in3(31), in_int(34))); out1(3, cloth_point_pdf(p, y, in3(28), in3(31))); ClothSample s = cloth_point_sample(p, y, in3(31), in2(39), in2(41)); out3(4, s.wi); out1(7, s.pdf);)

// ---- cloth_metal.h
ROW(ggx_d, 4, 1, out1(0, cloth_ggx_d(in3(0), in1(3)));)
ROW(ggx_stretch, 4, 1, out1(0, cloth_ggx_stretch(in3(0), in1(3)));)
ROW(fresnel_schlick, 4, 3, out3(0, cloth_fresnel_schlick(in3(0), in1(3)));)
ROW(metal_value, 10, 3, out3(0, cloth_metal_value(in3(0), in1(3), in3(4), in3(7)));)
ROW(metal_pdf, 7, 1, out1(0, cloth_metal_pdf(in1(0), in3(1), in3(4)));)
ROW(metal_sample, 6, 4, ClothSample s = cloth_metal_sample(in1(0), in3(1), in2(4)); out3(0, s.wi); out1(3, s.pdf);)

// ---- cloth_visibility.h
ROW(horizon_azimuth, 2, 1, out1(0, cloth_horizon_azimuth(in2(0)));)
ROW(horizon_step, 2, 1, out1(0, cloth_horizon_step(in1(0), in1(1)));)
ROW(horizon_visibility, 7, 1, out1(0, cloth_horizon_visibility(uvec2(in_word(0), in_word(2)), in3(4)));)

ROW(cap_visibility, 7, 1, out1(0, cloth_cap_visibility(uvec2(in_word(0), in_word(2)), in3(4)));)
ROW(visibility_at, 13, 1, ClothMaps m = in_maps(); m.tile_m = in2(7); m.height_low = in2(9); m.height_high = in2(11); out1(0, cloth_visibility_at(m, in_int(0), ivec2(in_int(1), in_int(2)), in3(4), ClothSettings(cloth_bsdf_meso, cloth_weight_relief, in_int(3), cloth_slab_ply, false, false, false)));)
ROW(asg_visibility, 11, 1, out1(0, cloth_asg_visibility(real4(in3(0), in1(3)), real4(in3(4), in1(7)), in3(8)));)

// ---- cloth_maps.h, cloth_footprint.h
ROW(decode_slopes, 2, 2, out2(0, cloth_decode_slopes(in_word(0)));)
ROW(texel_at, 2, 2, ivec2 xy = cloth_texel_at(in_maps(), in2(0)); out2(0, real2(real(xy.x), real(xy.y)));)
ROW(texel, 3, 16, out_texel(0, cloth_texel(in_maps(), in_int(0), ivec2(in_int(1), in_int(2)), ivec2(0, 0), false));)
ROW(horizon_at, 2, 2, ivec2 cell = cloth_horizon_at(in_maps(), ivec2(in_int(0), in_int(1))); out2(0, real2(real(cell.x), real(cell.y)));)
ROW(mean_slopes, 4, 2, out2(0, cloth_mean_slopes(in_maps(), in_int(0), in2(1), in_int(3)));)
ROW(area_from_mips, 10, 1, out1(0, cloth_area_from_mips(in_maps(), in_int(0), in_footprint(1), in3(7)));)
ROW(select, 18, 18, ClothSelection s = cloth_select(in_maps(), in_int(0), in_footprint(1), in3(7), ClothSettings(in_int(10), in_int(11) + 1, in_int(12), cloth_slab_ply, false, false, false), ClothRandom(in_word(13), in_word(15), uint(in_int(17)))); out1(0, s.passes ? real(1) : real(0)); out1(1, s.passes ? real(0) : s.weight); if (!s.passes) { out_texel(2, s.texel); } else { for (int k = 2; k < 18; ++k) { out1(k, real(0)); } })
ROW(bend, 4, 8, ivec2 xy = ivec2(in_int(1), in_int(2)); ClothTexel t = cloth_texel(in_maps(), in_int(0), xy, ivec2(0, 0), false); t.gap = false; ClothSelection s; s.passes = false; s.weight = real(1); s.texel = t; s.yarn = cloth_fetch_yarn(in_maps(), t.yarn); s.yarn.beneath = real(1); s.side = in_int(0); s.spot = xy << 2; s.repeat = ivec2(0, 0); s.u = in1(3); cloth_stack(in_maps(), s, ClothSettings(cloth_bsdf_micro, cloth_weight_relief, cloth_visibility_none, cloth_slab_ply, false, false, false)); out3(0, s.texel.point.tangent_t); out3(3, s.yarn.albedo_t); out1(6, s.yarn.alpha_t); out1(7, s.yarn.thickness_t);)
ROW(transmittance, 8, 1, out1(0, cloth_transmittance(in_maps(), in2(0), in3(2), ClothSettings(in_int(5), cloth_weight_tile, in_int(6), cloth_slab_ply, in_int(7) != 0, false, false)));)
ROW(noise, 6, 1, out1(0, cloth_noise(uvec2(in_word(0), in_word(2)), in2(4)));)

// ---- cloth_surface.h
ROW(camera_ray, 16, 12, ClothRay r = cloth_camera_ray(ClothCamera(in3(0), in3(3), in3(6), in3(9), in2(12)), in2(14)); out3(0, r.origin); out3(3, r.direction); out3(6, r.direction_dx); out3(9, r.direction_dy);)
ROW(lens_camera, 18, 6, ClothCamera c = cloth_lens_camera(ClothCamera(in3(0), in3(3), in3(6), in3(9), in2(12)), ClothLens(in1(14), in1(15)), in2(16)); out3(0, c.position); out3(3, c.forward);)
ROW(filter_offset, 3, 2, out2(0, cloth_filter_offset(in_int(0), in2(1)));)
ROW(barycentric, 27, 2, out2(0, cloth_barycentric(in_triangle(0), in3(24)));)
ROW(uv_frame, 27, 9, out_frame(0, cloth_uv_frame(cloth_facet(in_triangle(0)), in3(24)));)
ROW(surface, 36, 25, ClothSurface s = cloth_surface(in_triangle(0), in_ray(24)); out3(0, s.position); out3(3, s.normal_g); out_frame(6, s.frame); out3(15, s.wo); out2(18, s.tile); out2(20, s.tile_dx); out2(22, s.tile_dy); out1(24, real(s.side));)
ROW(leave, 6, 3, out3(0, cloth_leave(in3(0), in3(3)));)

// ---- cloth_light.h, cloth_direct.h
ROW(environment_direction, 3, 3, out3(0, cloth_environment_direction(in2(0), in1(2)));)
ROW(environment_uv, 4, 2, out2(0, cloth_environment_uv(in3(0), in1(3)));)
ROW(environment, 22, 4, real4 c = cloth_environment(in_lights(), in_light(0), in3(19)); out2(0, real2(c.x, c.y)); out2(2, real2(c.z, c.w));)
ROW(light_sample, 28, 8, out_light(0, cloth_light_sample(in_lights(), in_light(0), in3(19), in2(22), uvec2(in_word(24), in_word(26))));)
ROW(light_hit, 25, 8, out_light(0, cloth_light_hit(in_lights(), in_light(0), in3(19), in3(22)));)
ROW(ask_light, 3, 3, ClothLightChoice c = cloth_ask_light(in_lights(), in_int(1), in_int(2), in1(0)); out1(0, real(c.light.kind)); out1(1, c.u); out1(2, c.light.pmf);)
ROW(least, 2, 1, out1(0, cloth_least(in1(0), in1(1)));)
ROW(shadow_roulette, 3, 2, ClothShare s = cloth_shadow_roulette(ClothShare(in1(0), in1(1)), in1(2)); out1(0, s.left); out1(1, s.u);)

// ---- color.h
ROW(tone_neutral, 3, 3, out3(0, cloth_tone_neutral(in3(0)));)
ROW(srgb, 3, 3, out3(0, cloth_srgb(in3(0)));)
ROW(display, 4, 3, out3(0, cloth_display(in3(0), in1(3)));)
ROW(relmse_term, 2, 1, out1(0, cloth_relmse_term(in1(0), in1(1)));)

// ---- random.h: all bits must agree
ROW(hash, 2, 2, out_word(0, cloth_hash(in_word(0)));)
ROW(hash_combine, 4, 2, out_word(0, cloth_hash_combine(in_word(0), in_word(2)));)
ROW(random_bits, 6, 4, uvec2 b = cloth_random_bits(in_word(0), in_word(2), in_word(4)); out_word(0, b.x); out_word(2, b.y);)
ROW(random, 6, 2, out2(0, cloth_random(in_word(0), in_word(2), in_word(4)));)
ROW(block_length, 2, 1, out1(0, real(cloth_block_length(in_word(0))));)
