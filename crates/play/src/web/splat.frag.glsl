// A splat at a pixel.

flat in vec4 splat;
in vec2 place;
out vec4 blended;

void main() {
    float alpha = min(splat.w * exp(-0.5 * dot(place, place)), MAX_ALPHA);
    if (!(alpha >= MIN_ALPHA)) {
        discard;
    }
    blended = vec4(alpha * splat.rgb, alpha);
}
