// What lies in memory that both renderers read: yarn types and lights. Shared; imports interop.h.

// One yarn type.
struct ClothYarn {
    real3 albedo_r;    // single-scattering albedo of the slab seen in reflection, [0, 1]
    real3 albedo_t;    // the same in transmission
    real3 diffuse_r;   // diffuse reflectance kd_r, [0, 1]
    real3 diffuse_t;   // diffuse transmittance kd_t, [0, 1]
    real alpha_r;      // SGGX roughness of the reflection lobe, [cloth_alpha_min, 1]
    real alpha_t;      // of the transmission lobe
    real thickness;    // optical thickness T of the slab, > 0
    real2 twist;       // fibre angle to the ply, about the ply normal: cosine and sine
    real diffuse_mix;  // w of [4.1]: 1 = Lambert about the ply normal, 0 = about the macroscopic normal
    real3 reflectance; // rho of [9.1]: what a yarn surface gives back of light from all around, reflection lobes only
    real3 transmittance; // of light from all around, what comes out on the other side scattered; 0 where that is taken to meet no yarn
    real3 albedo;        // what it gives on in all, unscattered light included; rho where transmittance is 0
    real beneath;      // optical thickness of the yarn that lies under this one, where one does: on the straight way [model.md]
    real thickness_t;  // of the slab that bends light on its way through: that of this yarn, or of the one beneath
};

CLOTH_CONST int cloth_light_environment = 0;
CLOTH_CONST int cloth_light_directional = 1;   // with an angular diameter: the sun
CLOTH_CONST int cloth_light_point       = 2;
CLOTH_CONST int cloth_light_spot        = 3;
CLOTH_CONST int cloth_light_area        = 4;   // one-sided rectangle
CLOTH_CONST int cloth_light_flash       = 5;   // a phone's LED: point with a cosine lobe about its aim
CLOTH_CONST int cloth_light_mesh        = 6;   // an object that shines from its front

struct ClothLight {
    int kind;
    real pmf;          // probability of being chosen where one of all is, > 0; they add up to 1
    real3 position;    // [m]; area: centre; mesh: of a ball around it
    real3 axis;        // unit; directional: toward the light; others: the way it shines
    real3 radiance;    // directional: irradiance at normal incidence [W/m2]; area, mesh: radiance; point, spot, flash: intensity [W/sr]; environment: scale
    real3 edge_u;      // area: half edges [m]; mesh: x area [m2], y radius of the ball [m]
    real3 edge_v;
    real2 shape;       // directional: x = 1 - cos(half diameter); spot: cos(cone), cos(cone - penumbra); environment: rotation about y [rad]; mesh: first triangle and count in the table of emitters
};

// A triangle of a shining object, and its row of the alias table that draws triangles by area (Walker 1977).
struct ClothEmitter {
    real3 p0;         // [m], world
    real3 e1;         // p1 - p0, p2 - p0; counter-clockwise seen from the front
    real3 e2;
    uint threshold;   // 32-bit fraction: below, this triangle; otherwise
    uint other;       // this one, counted from the light's first
};
