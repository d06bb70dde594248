//! A cohort on the GPU: its constant values among the activated Gaussians, and the keypoints of one segment.

use std::collections::BTreeSet;
use std::ops::Range;

use tcgs_codec::{Keypoints, Segment};
use tcgs_core::{Activation, Attribute, Gaussians, Layout, activate, normalize};
use tcgs_render::device::{WORKGROUP, pack};
use tcgs_render::gpu::raw::Bound;
use tcgs_render::gpu::{Gpu, GpuError};

use super::kernels::{self, FrameUniform, MOVES, TrackUniform};

/// A cohort on the GPU, with the keypoints of one of its segments.
#[derive(Debug)]
pub(super) struct CohortOnGpu {
    index: usize,
    num_layers: usize,
    /// First timestep of the cohort.
    start: usize,
    /// Its rows among the activated Gaussians.
    rows: Range<usize>,
    frame: wgpu::Buffer,
    /// `[4 N]` quaternions as stored, if their components have keypoint times of their own: normalisation needs all
    /// four interpolated components.
    raw_quats: Option<wgpu::Buffer>,
    /// `[3 N]` colours, then `[(2 l + 1) 3 N]` coefficients of each degree `l`, if there are spherical harmonics.
    harmonics: Option<wgpu::Buffer>,
    /// One for each attribute that moves.
    moving: Vec<MovingAttribute>,
    /// Kernels after the interpolation, one thread per Gaussian.
    finishing: Vec<Bound>,
    /// Index of the segment whose keypoints are uploaded.
    segment: Option<usize>,
}

/// An attribute that moves.
#[derive(Debug)]
struct MovingAttribute {
    attribute: Attribute,
    num_units: usize,
    units: wgpu::Buffer,
    quantizers: wgpu::Buffer,
    uniform: wgpu::Buffer,
    /// The kernel with the keypoints of the uploaded segment.
    interpolate: Option<Bound>,
}

impl CohortOnGpu {
    /// Uploads the data that all segments of a cohort share: the constant values, the list of moving units, and the
    /// quantizers.
    ///
    /// - `segment`: any segment of the cohort
    /// - `start`: first of its rows
    /// - `activated`: `[14 num_rows]`
    ///
    /// # Errors
    /// [`GpuError::Memory`] if they do not fit.
    pub(super) fn new(
        gpu: &Gpu,
        segment: &Segment,
        start: usize,
        activated: &wgpu::Buffer,
        num_rows: usize,
    ) -> Result<Self, GpuError> {
        let n = segment.num_gaussians();
        let rows = start..start + n;
        let mut first = segment.first();
        let apart = segment.keypoints(Attribute::Quat).is_some_and(|keypoints| keypoints.channels == 1);
        let raw_quats = apart.then(|| gpu.upload("rotations as stored", first.quats())).transpose()?;
        for quat in first.quats_mut() {
            *quat = if quat.iter().any(|x| *x != 0.0) { normalize(*quat) } else { [1.0, 0.0, 0.0, 0.0] };
        }
        let values = pack(&activate(&first));
        for attribute in Attribute::BASE {
            let from = value_at(attribute, 0, n) as usize;
            let column = &values[from..from + n * attribute.components()];
            let at = 4 * u64::from(value_at(attribute, start, num_rows));
            gpu.queue().write_buffer(activated, at, bytemuck::cast_slice(column));
        }
        let bands = segment.layout().harmonics();
        let harmonics = if bands.is_empty() {
            None
        } else {
            let all = std::iter::once(Attribute::Color).chain(bands.iter().copied());
            let values: Vec<f32> = all.flat_map(|attribute| first.values(attribute).to_vec()).collect();
            Some(gpu.upload("harmonics", &values)?)
        };
        let frame = gpu.uniform("timestep", size_of::<FrameUniform>())?;
        let mut moving = Vec::new();
        // Attributes that the renderer does not know are not drawn.
        for attribute in Attribute::BASE.into_iter().chain(bands) {
            if segment.keypoints(attribute).is_some() {
                moving.push(MovingAttribute::new(gpu, segment, attribute)?);
            }
        }
        let mut cohort = Self {
            index: segment.cohort(),
            num_layers: segment.num_layers(),
            start: segment.start(),
            rows,
            frame,
            raw_quats,
            harmonics,
            moving,
            finishing: Vec::new(),
            segment: None,
        };
        cohort.finishing = cohort.finishing(gpu, segment, &first, activated, num_rows)?;
        Ok(cohort)
    }

    /// Whether a segment belongs to this cohort and was read with as many layers.
    pub(super) fn is_of(&self, segment: &Segment) -> bool {
        self.index == segment.cohort() && self.num_layers == segment.num_layers()
    }

    /// Its rows among the activated Gaussians.
    pub(super) fn rows(&self) -> Range<usize> {
        self.rows.clone()
    }

    /// Uploads the keypoints of a segment, unless they are uploaded already.
    ///
    /// # Errors
    /// [`GpuError::Memory`] if they do not fit.
    pub(super) fn load(
        &mut self,
        gpu: &Gpu,
        segment: &Segment,
        activated: &wgpu::Buffer,
        num_rows: usize,
    ) -> Result<(), GpuError> {
        if self.segment == Some(segment.index()) {
            return Ok(());
        }
        self.segment = None;
        let harmonic_columns = Layout::with_harmonics(segment.layout().sh_degree());
        for moving in &mut self.moving {
            // The old keypoints are freed first, because there may not be room for both.
            moving.interpolate = None;
            let Some(keypoints) = segment.keypoints(moving.attribute) else { continue };
            let attribute = moving.attribute;
            let (values, base) = match (&self.raw_quats, &self.harmonics) {
                (Some(raw_quats), _) if attribute == Attribute::Quat => (raw_quats, 0),
                (_, Some(harmonics)) if attribute == Attribute::Color || !is_base(attribute) => {
                    // Columns may stand in another order, or among columns that are not drawn.
                    let name = segment.layout().name(attribute);
                    let column = harmonic_columns.find(name).unwrap_or(attribute);
                    let before = harmonic_columns.offset(column) - harmonic_columns.offset(Attribute::Color);
                    (harmonics, (before * self.rows.len()) as u32)
                }
                _ => (activated, value_at(attribute, self.rows.start, num_rows)),
            };
            moving.load(gpu, &keypoints, values, base, &self.frame)?;
        }
        self.segment = Some(segment.index());
        Ok(())
    }

    /// Sets the timestep of the scene and the position of the camera.
    pub(super) fn set_frame(&self, gpu: &Gpu, timestep: usize, eye: [f64; 3]) {
        let frame = FrameUniform { eye: eye.map(|x| x as f32), timestep: (timestep - self.start) as u32 };
        gpu.queue().write_buffer(&self.frame, 0, bytemuck::bytes_of(&frame));
    }

    /// Records the dispatches that write the chosen timestep to the activated Gaussians.
    pub(super) fn record(&self, pass: &mut wgpu::ComputePass<'_>) {
        for moving in &self.moving {
            if let Some(interpolate) = &moving.interpolate {
                interpolate.dispatch_groups(pass, moving.num_units.div_ceil(WORKGROUP as usize));
            }
        }
        for kernel in &self.finishing {
            kernel.dispatch_over(pass, self.rows.len());
        }
    }

    /// The kernels that follow interpolation.
    fn finishing(
        &self,
        gpu: &Gpu,
        segment: &Segment,
        first: &Gaussians,
        activated: &wgpu::Buffer,
        num_rows: usize,
    ) -> Result<Vec<Bound>, GpuError> {
        let at = |attribute| value_at(attribute, self.rows.start, num_rows);
        let tracks = |base: u32, times_at: u32| {
            let uniform = gpu.uniform("tracks of a cohort", size_of::<TrackUniform>())?;
            let settings = TrackUniform { count: self.rows.len() as u32, base, times_at, codes_at: 0 };
            gpu.queue().write_buffer(&uniform, 0, bytemuck::bytes_of(&settings));
            Ok::<_, GpuError>(uniform)
        };
        let mut finishing = Vec::new();
        if let Some(raw_quats) = &self.raw_quats {
            let tracks = tracks(at(Attribute::Quat), 0)?;
            let kernel = gpu.kernel(&kernels::interpolate(1, Activation::Identity), "normalize_quats");
            finishing.push(kernel.bind(gpu.device(), &[(1, &tracks), (5, activated), (6, raw_quats)]));
        }
        if let Some(lives) = segment.lives() {
            let moving: BTreeSet<u32> = segment.moving_units(Attribute::LogitOpacity).map(|(place, _)| place).collect();
            let opacities = activate(first).opacities;
            let rows = lives.iter().zip(&opacities).zip(0..);
            let rows: Vec<[u32; 2]> = rows
                .map(|((life, opacity), g)| {
                    let opacity = if moving.contains(&g) { MOVES } else { opacity.to_bits() };
                    [life.birth | (life.death - 1) << 16, opacity]
                })
                .collect();
            let (rows, tracks) = (gpu.upload("lives", &rows)?, tracks(at(Attribute::LogitOpacity), 0)?);
            let kernel = gpu.kernel(&kernels::interpolate(1, Activation::Identity), "hide");
            let buffers = [(0, &self.frame), (1, &tracks), (2, &rows), (5, activated)];
            finishing.push(kernel.bind(gpu.device(), &buffers));
        }
        if let Some(harmonics) = &self.harmonics {
            let tracks = tracks(at(Attribute::Color), at(Attribute::Mean))?;
            let kernel = gpu.kernel(&kernels::shade(segment.layout().sh_degree()), "shade");
            let buffers = [(0, &self.frame), (1, &tracks), (2, harmonics), (5, activated)];
            finishing.push(kernel.bind(gpu.device(), &buffers));
        }
        Ok(finishing)
    }
}

impl MovingAttribute {
    fn new(gpu: &Gpu, segment: &Segment, attribute: Attribute) -> Result<Self, GpuError> {
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
            num_units: units.len(),
            units: gpu.upload("moving tracks", &units)?,
            quantizers: gpu.upload("quantizers", &quantizers)?,
            uniform: gpu.uniform("tracks of an attribute", size_of::<TrackUniform>())?,
            interpolate: None,
        })
    }

    /// - `values`: what the kernel writes; `base`: index of the attribute's first value in it
    fn load(
        &mut self,
        gpu: &Gpu,
        keypoints: &Keypoints<'_>,
        values: &wgpu::Buffer,
        base: u32,
        frame: &wgpu::Buffer,
    ) -> Result<(), GpuError> {
        if self.num_units == 0 {
            return Ok(());
        }
        let Keypoints { channels, starts, times, codes } = *keypoints;
        // Starts, times and codes as they lie in memory, in words of 16 bits: both WebGPU and the hosts are
        // little-endian.
        let mut halves: Vec<u16> = Vec::with_capacity(2 * starts.len() + times.len() + codes.len() + 1);
        halves.extend_from_slice(bytemuck::cast_slice(starts));
        let times_at = halves.len() as u32;
        halves.extend_from_slice(times);
        let codes_at = halves.len() as u32;
        halves.extend_from_slice(bytemuck::cast_slice(codes));
        halves.resize(halves.len().next_multiple_of(2), 0);
        let words = gpu.upload("keypoints", &halves)?;
        let tracks = TrackUniform { count: self.num_units as u32, base, times_at, codes_at };
        gpu.queue().write_buffer(&self.uniform, 0, bytemuck::bytes_of(&tracks));
        let buffers =
            [(0, frame), (1, &self.uniform), (2, &self.units), (3, &self.quantizers), (4, &words), (5, values)];
        let kernel =
            gpu.kernel(&kernels::interpolate(channels, activation_of(self.attribute, channels)), "interpolate");
        self.interpolate = Some(kernel.bind(gpu.device(), &buffers));
        Ok(())
    }
}

/// The activation that the kernel applies to interpolated values: that of the attribute's column. Rotations whose
/// components are interpolated one by one are normalised by a kernel of their own.
fn activation_of(attribute: Attribute, channels: usize) -> Activation {
    if !is_base(attribute) {
        return Activation::Identity;
    }
    match Layout::base().column(attribute).activation {
        Activation::Normalize if channels == 1 => Activation::Identity,
        activation => activation,
    }
}

/// Whether the renderer reads the attribute. The other attributes are bands of spherical harmonics.
fn is_base(attribute: Attribute) -> bool {
    Attribute::BASE.contains(&attribute)
}

/// Index of a row's value of an attribute in the array of activated Gaussians.
pub(super) fn value_at(attribute: Attribute, row: usize, num_rows: usize) -> u32 {
    (Layout::base().offset(attribute) * num_rows + attribute.components() * row) as u32
}
