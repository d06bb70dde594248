// The quad of one Gaussian: the square in which the splat's alpha reaches MIN_ALPHA, in the units of its standard
// deviations. The steps are those of `tcgs_render::project`.

precision highp usampler2D;

// Rows as `arrange/rows.rs` packs them, LINE in a line.
uniform usampler2D rows;
uniform vec4 camera_from_world[3];
uniform vec2 focal;
uniform vec2 principal;
uniform vec2 size;
uniform vec2 slope_min;
uniform vec2 slope_max;
// Gains of red, green and blue.
uniform vec3 light;
uniform bool antialiased;

layout(location = 0) in uint row;

// Colour, and opacity.
flat out vec4 splat;
// Distance from the centre, standard deviations.
out vec2 place;

uvec4 texel(int i) {
    return texelFetch(rows, ivec2(3 * int(row % LINE) + i, int(row / LINE)), 0);
}

void main() {
    // Outside of what is drawn, for what is culled.
    gl_Position = vec4(2.0, 2.0, 2.0, 1.0);
    uvec4 a = texel(0);
    uvec4 c = texel(2);
    vec3 mean = uintBitsToFloat(a.xyz);
    vec4 q = uintBitsToFloat(texel(1));
    vec3 scale = uintBitsToFloat(c.xyz);
    vec2 blue_opacity = unpackHalf2x16(c.w);
    splat = vec4(light * vec3(unpackHalf2x16(a.w), blue_opacity.x), blue_opacity.y);
    place = vec2(0.0);

    vec3 point;
    for (int i = 0; i < 3; i++) {
        point[i] = dot(camera_from_world[i].xyz, mean) + camera_from_world[i].w;
    }
    if (!(point.z > NEAR)) {
        return;
    }
    // Rows of the rotation of a unit quaternion w, x, y, z.
    vec3 r0 = vec3(1.0 - 2.0 * (q.z * q.z + q.w * q.w), 2.0 * (q.y * q.z - q.x * q.w), 2.0 * (q.y * q.w + q.x * q.z));
    vec3 r1 = vec3(2.0 * (q.y * q.z + q.x * q.w), 1.0 - 2.0 * (q.y * q.y + q.w * q.w), 2.0 * (q.z * q.w - q.x * q.y));
    vec3 r2 = vec3(2.0 * (q.y * q.w - q.x * q.z), 2.0 * (q.z * q.w + q.x * q.y), 1.0 - 2.0 * (q.y * q.y + q.z * q.z));
    vec3 factor[3];
    for (int i = 0; i < 3; i++) {
        vec3 w = camera_from_world[i].xyz;
        factor[i] = (w.x * r0 + w.y * r1 + w.z * r2) * scale;
    }
    vec2 slope = clamp(point.xy / point.z, slope_min, slope_max);
    vec2 per_depth = focal / point.z;
    vec3 u = per_depth.x * (factor[0] - slope.x * factor[2]);
    vec3 v = per_depth.y * (factor[1] - slope.y * factor[2]);
    float uu = dot(u, u);
    float vv = dot(v, v);
    float xx = uu + BLUR_VARIANCE;
    float xy = dot(u, v);
    // Determinants without the difference of two large numbers.
    vec3 normal = cross(u, v);
    float sharp = dot(normal, normal);
    float determinant = sharp + BLUR_VARIANCE * (uu + vv) + BLUR_VARIANCE * BLUR_VARIANCE;
    if (antialiased) {
        splat.w *= sqrt(min(sharp / determinant, 1.0));
    }
    if (!(splat.w >= MIN_ALPHA)) {
        return;
    }
    // The lower triangle of the covariance's Cholesky decomposition takes a unit square to a parallelogram around the
    // splat.
    float root = sqrt(xx);
    vec2 corner = vec2(float(gl_VertexID & 1), float(gl_VertexID >> 1)) * 2.0 - 1.0;
    place = corner * sqrt(2.0 * log(splat.w / MIN_ALPHA) + 1e-3);
    vec2 offset = vec2(root * place.x, (xy * place.x + sqrt(determinant) * place.y) / root);
    vec2 position = (focal * point.xy / point.z + principal + offset) / size;
    gl_Position = vec4(2.0 * position.x - 1.0, 1.0 - 2.0 * position.y, 0.0, 1.0);
}
