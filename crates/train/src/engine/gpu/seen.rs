//! Colours that depend on the direction of view, and back: spherical harmonics.
//!
//! Twin of [`tcgs_core::seen_colors()`] and its backward on the CPU. The floor is memory, for every Gaussian. Forward
//! reads its mean (12 bytes), its coefficients (36, 96 or 180) and its colour, and writes the colour (12). Backward
//! reads all of these and the gradients of mean and colour, and writes gradients of all.

use tcgs_render::device::Wgsl;
use tcgs_render::gpu::Gpu;
use tcgs_render::gpu::raw::Bound;

use crate::engine::device::{Packing, source};

/// Buffers of the kernels.
#[derive(Clone, Copy, Debug)]
pub(super) struct SeenBuffers<'a> {
    /// [`super::StepUniform`]
    pub step: &'a wgpu::Buffer,
    /// `[values * N]`, see [`Packing`].
    pub params: &'a wgpu::Buffer,
    /// `[(11 + C) D]`, as activation leaves it.
    pub activated: &'a wgpu::Buffer,
    /// `[values * N]`, as the backward of activation leaves it.
    pub grads: &'a wgpu::Buffer,
    /// Lists of the Gaussians that each view draws, and their colours as the view sees them; none if everything is
    /// trained.
    pub part: Option<[&'a wgpu::Buffer; 2]>,
}

/// Colours as a camera sees them, forward and backward, bound to their buffers.
#[derive(Clone, Debug)]
pub(super) struct SeenKernels {
    place: Option<Bound>,
    fwd: Bound,
    bwd: Bound,
    num_gaussians: usize,
    max_listed: usize,
}

impl SeenKernels {
    /// Binds the kernels. There are none for a layout without harmonics.
    ///
    /// - `max_listed`: most Gaussians that a view lists
    pub fn new(
        gpu: &Gpu,
        packing: &Packing,
        buffers: SeenBuffers<'_>,
        num_gaussians: usize,
        max_listed: usize,
    ) -> Option<Self> {
        if packing.layout().sh_degree() == 0 {
            return None;
        }
        let source = shader(packing);
        let b = buffers;
        let bind = |entry, bound: &[(u32, &wgpu::Buffer)]| gpu.kernel(&source, entry).bind(gpu.device(), bound);
        let place =
            b.part.map(|[lists, colors]| bind("place_seen", &[(0, b.step), (2, b.activated), (4, lists), (5, colors)]));
        let fwd = bind("seen_fwd", &[(0, b.step), (1, b.params), (2, b.activated)]);
        let bwd = bind("seen_bwd", &[(0, b.step), (1, b.params), (2, b.activated), (3, b.grads)]);
        Some(Self { place, fwd, bwd, num_gaussians, max_listed })
    }

    /// Records the forward: *overwrites* the colours of all Gaussians that the view draws; rows get theirs in place of
    /// the colours that activation wrote.
    pub fn record_fwd(&self, pass: &mut wgpu::ComputePass<'_>) {
        if let Some(place) = &self.place {
            place.dispatch_over(pass, self.max_listed);
        }
        self.fwd.dispatch_over(pass, self.num_gaussians);
    }

    /// Records the backward: *overwrites* the gradients of colours and harmonics, and *accumulates* into those of the
    /// means.
    pub fn record_bwd(&self, pass: &mut wgpu::ComputePass<'_>) {
        self.bwd.dispatch_over(pass, self.num_gaussians);
    }
}

pub(super) fn shader(packing: &Packing) -> String {
    let bands = packing.layout().harmonics();
    let mut constants = Wgsl::new().activated_columns();
    for (place, name) in ["SH1_AT", "SH2_AT", "SH3_AT"].into_iter().enumerate() {
        constants = constants.constant(name, bands.get(place).map_or(0, |&band| packing.offset(band)));
    }
    let num_coefficients = (bands.len() + 1).pow(2) - 1;
    source(packing, constants.constant("NUM_COEFFICIENTS", num_coefficients))
        .harmonics()
        .part(include_str!("seen.wgsl"))
        .finish()
}

#[cfg(test)]
mod tests {
    use tcgs_core::{Attribute, Camera, GaussianGrads, Layout, seen_colors, seen_colors_bwd};

    use super::*;
    use crate::engine::device::StepUniform;
    use crate::engine::gpu::test_support::{assert_close, gpu, random, random_gaussians, run, uniform_of};

    /// All columns and as many mask logits, zero.
    fn packed(packing: &Packing, columns: &tcgs_core::Columns<impl Sized>, n: usize) -> Vec<f32> {
        packing.pack(columns, &vec![0.0; n])
    }

    #[test]
    fn colours_and_gradients_are_those_of_the_cpu() {
        let Some(gpu) = gpu() else { return };
        let camera = Camera::look_at([0.3, -0.2, -4.0], [0.0; 3], [0.0, -1.0, 0.0], 50.0, 64, 48);
        let eye = camera.center().map(|x| x as f32);
        for (degree, n, flags) in [(1, 700, 0), (2, 256, StepUniform::SEGMENTED), (3, 1301, 0), (3, 1, 0)] {
            let channels = if flags == 0 { 3 } else { 5 };
            let layout = Layout::with_harmonics(degree);
            let packing = Packing::new(&layout);
            let mut gaussians = random_gaussians(1, n).extended(&layout);
            for band in layout.harmonics() {
                let values = random(7, n * band.components(), -0.4, 0.4);
                gaussians.values_mut(band).copy_from_slice(&values);
            }
            let mut v = GaussianGrads::zeros_of(&layout, n);
            v.values_mut(Attribute::Color).copy_from_slice(&random(8, 3 * n, -1.0, 1.0));
            v.values_mut(Attribute::Mean).copy_from_slice(&random(9, 3 * n, -1.0, 1.0));

            // Some Gaussians beyond the rows; the view lists them backwards among others.
            let num_drawn = n + 5;
            let listed: Vec<u32> = (0..num_drawn as u32).rev().collect();
            let elsewhere = random(10, channels * num_drawn, 0.0, 1.0);
            let mut activated = random(11, (11 + channels) * num_drawn, 0.0, 1.0);
            for (i, color) in gaussians.colors().iter().enumerate() {
                activated[11 * num_drawn + channels * i..][..3].copy_from_slice(color);
            }
            let step = StepUniform {
                num_gaussians: n as u32,
                num_drawn: num_drawn as u32,
                num_listed: num_drawn as u32,
                lists_at: 2,
                colors_at: 3,
                flags,
                eye_x: eye[0],
                eye_y: eye[1],
                eye_z: eye[2],
                ..StepUniform::default()
            };
            let upload = |values: &[f32]| gpu.upload("values", values).unwrap();
            let (stored, drawn) = (activated.clone(), upload(&activated));
            let grads = upload(&packed(&packing, &v, n));
            let lists = gpu.upload("lists", &[&[9, 9], &listed[..]].concat()).unwrap();
            let colors = upload(&[&[9.0; 3], &elsewhere[..]].concat());
            let buffers = SeenBuffers {
                step: &uniform_of(&gpu, &packing, &step, &[]),
                params: &upload(&packed(&packing, &gaussians, n)),
                activated: &drawn,
                grads: &grads,
                part: None,
            };
            let kernels = SeenKernels::new(&gpu, &packing, buffers, n, 0).unwrap();
            run(&gpu, |pass| kernels.record_fwd(pass));
            let found: Vec<f32> = gpu.read(&drawn, activated.len()).unwrap();
            for (row, seen) in seen_colors(&gaussians, &camera).chunks(3).enumerate() {
                let at = 11 * num_drawn + channels * row;
                assert_close(&format!("color {row} of degree {degree}"), &found[at..][..3], seen, 1e-5);
                activated[at..][..3].copy_from_slice(&found[at..][..3]);
            }
            assert_eq!(found, activated, "nothing but the rows' colours");

            run(&gpu, |pass| kernels.record_bwd(pass));
            seen_colors_bwd(&gaussians, &camera, &mut v);
            let found: Vec<f32> = gpu.read(&grads, packing.values() * n).unwrap();
            for attribute in layout.attributes() {
                let (at, values) = (packing.offset(attribute) * n, v.values(attribute));
                let name = format!("v of {} of degree {degree}", layout.name(attribute));
                assert_close(&name, &found[at..][..values.len()], values, 1e-5);
            }

            // In a part of a scene the view sees Gaussians that are not rows in the given colours.
            let again = upload(&stored);
            let with_part = SeenBuffers { activated: &again, part: Some([&lists, &colors]), ..buffers };
            let kernels = SeenKernels::new(&gpu, &packing, with_part, n, num_drawn).unwrap();
            run(&gpu, |pass| kernels.record_fwd(pass));
            for number in n..num_drawn {
                let at = channels * (num_drawn - 1 - number);
                let expected = &elsewhere[at..][..channels];
                activated[11 * num_drawn + channels * number..][..channels].copy_from_slice(expected);
            }
            assert_eq!(gpu.read::<f32>(&again, activated.len()).unwrap(), activated);
        }
    }
}
