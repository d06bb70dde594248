//! Reconstructs any timestep of a segment on the GPU. The keypoints of a segment are uploaded once; a frame uploads the
//! index of its timestep alone.
//!
//! The steps are those of [`tcgs_codec::Sampler`] on the CPU: codes become values, values between two keypoints are
//! interpolated linearly, rotations get unit length; then follows [`tcgs_core::activate`]. The arithmetic is f32
//! throughout, where the codec dequantises in f64, so values differ in their last bits.

use bytemuck::{Pod, Zeroable};
use tcgs_codec::{Keypoints, Segment};
use tcgs_core::{Activation, Attribute, Layout, activate, normalize};
use tcgs_render::device::{MAX_GROUPS_X, WORKGROUP, Wgsl, pack};
use tcgs_render::gpu::raw::Bound;
use tcgs_render::gpu::{Gpu, GpuError};

/// What a kernel knows of its attribute; of the same name in the shader.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
struct TrackUniform {
    /// Units of the attribute that move.
    count: u32,
    /// Index of the attribute's first value in the buffer that the kernel writes.
    base: u32,
    /// Index of the first keypoint time, in words of 16 bits.
    times_at: u32,
    /// Index of the first code, in words of 16 bits.
    codes_at: u32,
}

/// A scene on the GPU, with the keypoints of one of its segments.
#[derive(Debug)]
pub struct Reconstruction {
    gpu: Gpu,
    num_gaussians: usize,
    /// `[14 N]` activated Gaussians in the order that the renderer reads.
    activated: wgpu::Buffer,
    /// `[4 N]` quaternions as stored, if their components have keypoint times of their own: they get unit length only
    /// after all four are interpolated.
    raw_quats: Option<wgpu::Buffer>,
    frame: wgpu::Buffer,
    /// One for each attribute that moves.
    moving: Vec<MovingAttribute>,
    normalize_quats: Option<Bound>,
    /// Index of the segment whose keypoints are uploaded.
    segment: Option<usize>,
}

/// An attribute that moves.
#[derive(Debug)]
struct MovingAttribute {
    attribute: Attribute,
    activation: Activation,
    num_units: usize,
    units: wgpu::Buffer,
    quantizers: wgpu::Buffer,
    uniform: wgpu::Buffer,
    /// The kernel with the keypoints of the uploaded segment.
    interpolate: Option<Bound>,
}

/// WGSL of the kernel.
///
/// - `unit`: components of a unit: 1, 3 or 4
/// - `activation`: of the interpolated values
fn source(unit: usize, activation: Activation) -> String {
    Wgsl::new()
        .constant("UNIT", unit)
        .constant("ACTIVATION", activation as u32)
        .constant("EXP", Activation::Exp as u32)
        .constant("SIGMOID", Activation::Sigmoid as u32)
        .constant("NORMALIZE", Activation::Normalize as u32)
        .constant("WORKGROUP", WORKGROUP)
        .constant("MAX_GROUPS_X", MAX_GROUPS_X)
        .part(include_str!("reconstruct.wgsl"))
        .finish()
}

/// Name and WGSL of every shader of the reconstruction, as the GPU gets it.
pub(crate) fn sources() -> Vec<(String, String)> {
    use Activation::{Exp, Identity, Normalize, Sigmoid};
    let all = [(1, Identity), (1, Exp), (1, Sigmoid), (3, Identity), (3, Exp), (4, Normalize)];
    let name = |unit, activation| format!("reconstruct_{unit}_{activation:?}").to_lowercase();
    all.map(|(unit, activation)| (name(unit, activation), source(unit, activation))).into()
}

impl Reconstruction {
    /// Uploads what all segments of a scene share: the values that do not move, which units move, and the quantizers.
    ///
    /// - `segment`: any segment of the scene
    ///
    /// # Errors
    /// [`GpuError::Memory`] if the scene does not fit.
    pub fn new(gpu: &Gpu, segment: &Segment) -> Result<Self, GpuError> {
        let n = segment.num_gaussians();
        let mut first = segment.first();
        let apart = segment.keypoints(Attribute::Quat).is_some_and(|keypoints| keypoints.channels == 1);
        let raw_quats = apart.then(|| gpu.upload("rotations as stored", first.quats())).transpose()?;
        for quat in first.quats_mut() {
            *quat = if quat.iter().any(|x| *x != 0.0) { normalize(*quat) } else { [1.0, 0.0, 0.0, 0.0] };
        }
        let activated = gpu.upload("activated Gaussians", &pack(&activate(&first)))?;
        let frame = gpu.uniform("timestep", 16)?;
        let mut moving = Vec::new();
        // The renderer reads the base attributes alone.
        for attribute in Attribute::BASE {
            if let Some(keypoints) = segment.keypoints(attribute) {
                moving.push(MovingAttribute::new(gpu, segment, attribute, keypoints.channels)?);
            }
        }
        let normalize_quats = match &raw_quats {
            None => None,
            Some(raw_quats) => {
                let uniform = gpu.uniform("rotations", size_of::<TrackUniform>())?;
                let base = base_of(Attribute::Quat, n);
                let settings = TrackUniform { count: n as u32, base, times_at: 0, codes_at: 0 };
                gpu.queue().write_buffer(&uniform, 0, bytemuck::bytes_of(&settings));
                let kernel = gpu.kernel(&source(1, Activation::Identity), "normalize_quats");
                Some(kernel.bind(gpu.device(), &[(1, &uniform), (5, &activated), (6, raw_quats)]))
            }
        };
        Ok(Self {
            gpu: gpu.clone(),
            num_gaussians: n,
            activated,
            raw_quats,
            frame,
            moving,
            normalize_quats,
            segment: None,
        })
    }

    /// Number of Gaussians `N`.
    pub fn num_gaussians(&self) -> usize {
        self.num_gaussians
    }

    /// `[14 N]` the activated Gaussians of the timestep that [`Self::record`] reconstructs, as the renderer reads them.
    pub fn activated(&self) -> &wgpu::Buffer {
        &self.activated
    }

    /// Uploads the keypoints of a segment, unless they are uploaded already.
    ///
    /// - `segment`: of the scene that [`Self::new`] was given, read with as many layers
    ///
    /// # Errors
    /// [`GpuError::Memory`] if they do not fit.
    ///
    /// # Panics
    /// If the segment has another number of Gaussians than the scene.
    pub fn load(&mut self, segment: &Segment) -> Result<(), GpuError> {
        assert_eq!(segment.num_gaussians(), self.num_gaussians, "Gaussians of the segment, and of the scene");
        if self.segment == Some(segment.index()) {
            return Ok(());
        }
        self.segment = None;
        for moving in &mut self.moving {
            // The keypoints of the segment before go first: there need not be room for both.
            moving.interpolate = None;
            let Some(keypoints) = segment.keypoints(moving.attribute) else { continue };
            let values = match &self.raw_quats {
                Some(raw_quats) if moving.attribute == Attribute::Quat => raw_quats,
                _ => &self.activated,
            };
            moving.load(&self.gpu, &keypoints, values, &self.frame, self.num_gaussians)?;
        }
        self.segment = Some(segment.index());
        Ok(())
    }

    /// Chooses the timestep that passes submitted from now on reconstruct.
    ///
    /// - `timestep`: of the scene, within the uploaded segment
    pub fn set_timestep(&self, timestep: usize) {
        self.gpu.queue().write_buffer(&self.frame, 0, bytemuck::cast_slice(&[timestep as u32, 0, 0, 0]));
    }

    /// Records the dispatches that write the chosen timestep to [`Self::activated`].
    pub fn record(&self, pass: &mut wgpu::ComputePass<'_>) {
        for moving in &self.moving {
            if let Some(interpolate) = &moving.interpolate {
                interpolate.dispatch_groups(pass, moving.num_units.div_ceil(WORKGROUP as usize));
            }
        }
        if let Some(normalize_quats) = &self.normalize_quats {
            normalize_quats.dispatch_over(pass, self.num_gaussians);
        }
    }
}

impl MovingAttribute {
    fn new(gpu: &Gpu, segment: &Segment, attribute: Attribute, channels: usize) -> Result<Self, GpuError> {
        // The quantizers of all widths lie in one table, so that a unit finds its own by one index.
        let components = attribute.components();
        let mut rows = [0_u32; 17];
        let mut quantizers = Vec::new();
        for (&width, channels) in &segment.quantizers().attributes[attribute.index()] {
            rows[usize::from(width)] = quantizers.len() as u32;
            quantizers.extend(channels.iter().map(|quantizer| [quantizer.step, quantizer.offset]));
        }
        let units: Vec<[u32; 2]> = segment
            .moving_units(attribute)
            .map(|(place, width)| [place, rows[usize::from(width)] + place % components as u32])
            .collect();
        Ok(Self {
            attribute,
            activation: activation_of(attribute, channels),
            num_units: units.len(),
            units: gpu.upload("moving tracks", &units)?,
            quantizers: gpu.upload("quantizers", &quantizers)?,
            uniform: gpu.uniform("tracks of an attribute", size_of::<TrackUniform>())?,
            interpolate: None,
        })
    }

    fn load(
        &mut self,
        gpu: &Gpu,
        keypoints: &Keypoints<'_>,
        values: &wgpu::Buffer,
        frame: &wgpu::Buffer,
        num_gaussians: usize,
    ) -> Result<(), GpuError> {
        if self.num_units == 0 {
            return Ok(());
        }
        let Keypoints { channels, starts, times, codes } = *keypoints;
        // Starts, times and codes as they lie in memory, in words of 16 bits: both WebGPU and the hosts are little-endian.
        let mut halves: Vec<u16> = Vec::with_capacity(2 * starts.len() + times.len() + codes.len() + 1);
        halves.extend_from_slice(bytemuck::cast_slice(starts));
        let times_at = halves.len() as u32;
        halves.extend_from_slice(times);
        let codes_at = halves.len() as u32;
        halves.extend_from_slice(bytemuck::cast_slice(codes));
        halves.resize(halves.len().next_multiple_of(2), 0);
        let words = gpu.upload("keypoints", &halves)?;
        // Rotations whose components have keypoint times of their own are interpolated into a buffer of their own.
        let is_raw = self.attribute == Attribute::Quat && channels == 1;
        let base = if is_raw { 0 } else { base_of(self.attribute, num_gaussians) };
        let tracks = TrackUniform { count: self.num_units as u32, base, times_at, codes_at };
        gpu.queue().write_buffer(&self.uniform, 0, bytemuck::bytes_of(&tracks));
        let buffers =
            [(0, frame), (1, &self.uniform), (2, &self.units), (3, &self.quantizers), (4, &words), (5, values)];
        let kernel = gpu.kernel(&source(channels, self.activation), "interpolate");
        self.interpolate = Some(kernel.bind(gpu.device(), &buffers));
        Ok(())
    }
}

/// What the kernel does with interpolated values: the activation of the attribute's column, but where a rotation's
/// components are interpolated one by one, they get unit length by a kernel of its own.
fn activation_of(attribute: Attribute, channels: usize) -> Activation {
    match Layout::base().column(attribute).activation {
        Activation::Normalize if channels == 1 => Activation::Identity,
        activation => activation,
    }
}

/// Index at which the values of an attribute begin in the buffer of activated Gaussians.
fn base_of(attribute: Attribute, num_gaussians: usize) -> u32 {
    (Layout::base().offset(attribute) * num_gaussians) as u32
}
