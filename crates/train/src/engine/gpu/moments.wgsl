
// One value of Adam (Kingma and Ba 2015, Algorithm 1), as `Moments::update` on the CPU.
//
// - `state`: value, first moment, second moment
// - `v`: gradient to the value
// - `rates`: step size, correction, ε
fn adam_moved(state: vec3<f32>, v: f32, rates: vec3<f32>) -> vec3<f32> {
    let first = BETA1 * state.y + (1.0 - BETA1) * v;
    let second = BETA2 * state.z + (1.0 - BETA2) * v * v;
    return vec3(state.x - rates.x * first / (sqrt(second) * rates.y + rates.z), first, second);
}
