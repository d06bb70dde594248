// The picture, pixel by pixel, and over it an edge if it cannot be trusted.

uniform sampler2D picture;
// Left and lower edge of the place.
uniform ivec2 corner;
// Strength of the edge, in [0, 1]; at 0 the picture stays as it is.
uniform float doubt;
// Of the camera, pixels; the principal point is from the lower left corner of the place.
uniform vec2 focal;
uniform vec2 principal;
out vec4 color;

// Colour of the edge, sRGB, and its largest opacity: those of the page (web/src/style.css).
const vec4 EDGE = vec4(1.0, 0.69, 0.25, 0.55);
// Slopes of the rays to the camera's axis at which the edge begins, and at which it has its full opacity.
const vec2 SLOPES = vec2(0.6, 1.1);

void main() {
    ivec2 pixel = ivec2(gl_FragCoord.xy) - corner;
    vec3 seen = texelFetch(picture, pixel, 0).rgb;
    if (doubt > 0.0) {
        float slope = length((vec2(pixel) + 0.5 - principal) / focal);
        seen = mix(seen, EDGE.rgb, doubt * EDGE.a * smoothstep(SLOPES.x, SLOPES.y, slope));
    }
    color = vec4(seen, 1.0);
}
