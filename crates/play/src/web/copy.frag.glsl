// The picture, pixel by pixel.

uniform sampler2D picture;
// Left and lower edge of the place.
uniform ivec2 corner;
out vec4 color;

void main() {
    color = vec4(texelFetch(picture, ivec2(gl_FragCoord.xy) - corner, 0).rgb, 1.0);
}
