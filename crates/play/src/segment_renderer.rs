//! One scene on the GPU, drawn to textures: reconstruction, the renderer that training uses (forward alone), blit.
//!
//! Nothing waits for the GPU. The number of tile-splat pairs of a frame is read back some frames later, and the buffers
//! grow before they are full. A picture whose pairs exceed the capacity stays empty for the few frames until the count
//! is known ([`SegmentRenderer::is_whole`]). A [`Still`] is drawn again until it is whole.

use tcgs_core::Camera;
use tcgs_render::RenderSettings;
use tcgs_render::device::Capacity;
use tcgs_render::gpu::raw::{GpuRenderer, Staged};
use tcgs_render::gpu::{Gpu, GpuError};

use crate::blit::{self, Blit};
use crate::error::PlayError;
use crate::holdings::Moment;
use crate::reconstruct::Reconstruction;
use crate::renderer::{PictureRequest, Renderer};

/// Tile-splat pairs per Gaussian in the first buffers: a picture of full size has two to seven.
const FIRST_PAIRS: usize = 6;
/// Format of the textures of stills.
const STILL_FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::Rgba8Unorm;
/// Texture rows are copied to a buffer in multiples of this many bytes.
const ROW_BYTES: usize = wgpu::COPY_BYTES_PER_ROW_ALIGNMENT as usize;

/// Draws the timesteps of one scene; cohorts and segments are uploaded when needed.
#[derive(Debug)]
pub struct SegmentRenderer {
    gpu: Gpu,
    reconstruction: Reconstruction,
    renderer: Option<GpuRenderer>,
    /// Capacity of the next renderer, tile-splat pairs.
    num_pairs: usize,
    /// Pair counts of an earlier frame, on their way from the GPU.
    counts: Option<Staged>,
    is_whole: bool,
    blit: Blit,
    blit_still: Option<Blit>,
}

/// A picture on its way back from the GPU.
#[derive(Debug)]
pub struct Still {
    size: [usize; 2],
    pixels: Staged,
    counts: Staged,
}

impl Still {
    /// Whether the pixels had arrived when the GPU was last polled.
    pub fn is_ready(&self) -> bool {
        self.pixels.is_ready() && self.counts.is_ready()
    }
}

impl SegmentRenderer {
    /// A renderer that has uploaded nothing yet.
    ///
    /// - `format`: format of the textures that [`Self::draw`] draws to. It must not encode sRGB
    ///
    /// # Errors
    /// [`GpuError::Memory`] if nothing at all fits.
    pub fn new(gpu: &Gpu, format: wgpu::TextureFormat) -> Result<Self, GpuError> {
        Ok(Self {
            gpu: gpu.clone(),
            reconstruction: Reconstruction::new(gpu)?,
            renderer: None,
            num_pairs: 0,
            counts: None,
            is_whole: true,
            blit: Blit::new(gpu, format)?,
            blit_still: None,
        })
    }

    /// Whether the buffers had room for all pairs of the last frame whose counts have arrived.
    pub fn is_whole(&self) -> bool {
        self.is_whole
    }

    /// Submits the drawing of a picture to a texture, without waiting for the GPU.
    ///
    /// - `target`: a texture of the size of the camera's image
    ///
    /// # Errors
    /// [`GpuError::Memory`] if buffers for the picture do not fit; otherwise what has gone wrong on the GPU so far.
    pub fn draw(&mut self, request: &PictureRequest<'_, Moment>, target: &wgpu::TextureView) -> Result<(), GpuError> {
        self.take_counts()?;
        let mut encoder = self.gpu.encoder();
        self.render(request, &mut encoder)?;
        let Some(renderer) = &self.renderer else { return Ok(()) };
        let size = [request.camera.width, request.camera.height];
        self.blit.record(&self.gpu, &mut encoder, &renderer.buffers().image, size, request.light, target);
        let counts = match &self.counts {
            None => Some(self.gpu.stage(&mut encoder, &renderer.buffers().status, 4)?),
            Some(_) => None,
        };
        self.gpu.submit(encoder);
        if let Some(counts) = counts {
            counts.map(&self.gpu);
            self.counts = Some(counts);
        }
        self.gpu.poll()
    }

    /// Submits the drawing of a picture whose pixels are read back, without waiting for the GPU.
    ///
    /// # Errors
    /// [`GpuError::Memory`] if buffers for the picture do not fit; otherwise what has gone wrong on the GPU so far.
    pub fn begin_still(&mut self, request: &PictureRequest<'_, Moment>) -> Result<Still, GpuError> {
        self.take_counts()?;
        let size @ [width, height] = [request.camera.width, request.camera.height];
        let texture = self.gpu.device().create_texture(&wgpu::TextureDescriptor {
            label: Some("still"),
            size: extent(size),
            mip_level_count: 1,
            sample_count: 1,
            dimension: wgpu::TextureDimension::D2,
            format: STILL_FORMAT,
            usage: wgpu::TextureUsages::RENDER_ATTACHMENT | wgpu::TextureUsages::COPY_SRC,
            view_formats: &[],
        });
        let row_bytes = (4 * width).next_multiple_of(ROW_BYTES);
        let words = row_bytes / 4 * height;
        let buffer = self.gpu.storage("a still", words)?;
        if self.blit_still.is_none() {
            self.blit_still = Some(Blit::new(&self.gpu, STILL_FORMAT)?);
        }
        let mut encoder = self.gpu.encoder();
        self.render(request, &mut encoder)?;
        let (Some(renderer), Some(blit)) = (&self.renderer, &self.blit_still) else {
            return Err(GpuError::Lost("there is no renderer".into()));
        };
        let view = texture.create_view(&wgpu::TextureViewDescriptor::default());
        blit.record(&self.gpu, &mut encoder, &renderer.buffers().image, size, request.light, &view);
        let layout = wgpu::TexelCopyBufferLayout {
            offset: 0,
            bytes_per_row: Some(row_bytes as u32),
            rows_per_image: Some(height as u32),
        };
        encoder.copy_texture_to_buffer(
            texture.as_image_copy(),
            wgpu::TexelCopyBufferInfo { buffer: &buffer, layout },
            extent(size),
        );
        let pixels = self.gpu.stage(&mut encoder, &buffer, words)?;
        let counts = self.gpu.stage(&mut encoder, &renderer.buffers().status, 4)?;
        self.gpu.submit(encoder);
        for staged in [&pixels, &counts] {
            staged.map(&self.gpu);
        }
        self.gpu.poll()?;
        Ok(Still { size, pixels, counts })
    }

    /// Takes the pixels of a still that is ready.
    ///
    /// - returns: `[H, W, 4]` RGBA, 8 bits each, rows from the top. `None` if the buffers were too small: then the
    ///   caller draws again, and the next drawing creates larger buffers
    ///
    /// # Errors
    /// [`GpuError::Memory`] if the buffers cannot become large enough; otherwise what has gone wrong on the GPU so far.
    pub fn finish_still(&mut self, still: &Still) -> Result<Option<Vec<u8>>, GpuError> {
        let counts = still.counts.take(&self.gpu)?;
        if !self.learn(&counts) {
            return self.check_room().map(|()| None);
        }
        let [width, height] = still.size;
        let bytes: Vec<u8> = still.pixels.take(&self.gpu)?.into_iter().flat_map(u32::to_le_bytes).collect();
        let rows = bytes.chunks_exact((4 * width).next_multiple_of(ROW_BYTES)).take(height);
        Ok(Some(rows.flat_map(|row| &row[..4 * width]).copied().collect()))
    }

    /// Records everything up to the renderer's image.
    fn render(
        &mut self,
        request: &PictureRequest<'_, Moment>,
        encoder: &mut wgpu::CommandEncoder,
    ) -> Result<(), GpuError> {
        self.reconstruction.load(request.moment, request.camera.center())?;
        self.make_room(request.camera)?;
        let Some(renderer) = &mut self.renderer else { return Ok(()) };
        // The blit multiplies the whole picture by the light.
        let background: [f32; 3] = std::array::from_fn(|c| request.background[c] / request.light[c]);
        let settings = RenderSettings::default().or_background(&background);
        renderer.set_view(request.camera, &settings, request.moment.is_antialiased());
        self.gpu.queue().write_buffer(&renderer.buffers().status, 0, &[0; 16]);
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default());
        self.reconstruction.record(&mut pass);
        renderer.project(&mut pass);
        renderer.sort(&mut pass);
        renderer.rasterize(&mut pass);
        Ok(())
    }

    /// Creates a new renderer if its buffers are too small for a picture.
    fn make_room(&mut self, camera: &Camera) -> Result<(), GpuError> {
        let n = self.reconstruction.num_rows();
        let mut capacity = Capacity::new(n, 3, [camera], false);
        capacity.num_pairs = self.num_pairs.max(FIRST_PAIRS * n + 16 * capacity.num_tiles);
        if let Some(renderer) = &self.renderer {
            let held = renderer.capacity();
            if held.serves(&capacity) {
                return Ok(());
            }
            // Enlarging a window should not need new buffers with every pixel.
            if held.num_pixels < capacity.num_pixels {
                capacity.num_pixels += capacity.num_pixels / 8;
            }
            capacity.num_pixels = capacity.num_pixels.max(held.num_pixels);
            capacity.num_tiles = capacity.num_tiles.max(held.num_tiles);
            capacity.num_pairs = capacity.num_pairs.max(held.num_pairs);
        }
        // The old buffers are freed first, because there may not be room for both.
        self.renderer = None;
        self.counts = None;
        self.renderer = Some(GpuRenderer::of_gaussians(&self.gpu, capacity, self.reconstruction.activated())?);
        Ok(())
    }

    /// Takes the counts of an earlier frame, if they have arrived.
    fn take_counts(&mut self) -> Result<(), GpuError> {
        self.gpu.poll()?;
        if let Some(counts) = self.counts.take_if(|counts| counts.is_ready()) {
            self.is_whole = self.learn(&counts.take(&self.gpu)?);
        }
        Ok(())
    }

    /// Sets the size of the next buffers from the counts of a frame.
    ///
    /// - `counts`: the renderer's status after a frame
    /// - returns: whether there was room for all pairs
    fn learn(&mut self, counts: &[u32]) -> bool {
        let [halted, _, needed, _] = *counts else { return false };
        let needed = needed as usize;
        let held = self.renderer.as_ref().map_or(0, |renderer| renderer.capacity().num_pairs);
        if needed > held - held / 4 {
            self.num_pairs = needed.max(held).saturating_add(needed.max(held) / 2).min(self.max_pairs());
        }
        halted == 0
    }

    /// An error if the buffers already hold as many pairs as a buffer can.
    fn check_room(&self) -> Result<(), GpuError> {
        match &self.renderer {
            Some(renderer) if renderer.capacity().num_pairs >= self.max_pairs() => Err(GpuError::Memory {
                what: "a picture of so many splats in so many tiles".into(),
                bytes: 4 * renderer.capacity().num_pairs as u64 + 4,
                problem: "more than a buffer may have".into(),
            }),
            _ => Ok(()),
        }
    }

    /// Number of pairs that one buffer of this GPU can hold.
    fn max_pairs(&self) -> usize {
        let limits = self.gpu.device().limits();
        let bytes = limits.max_storage_buffer_binding_size.min(limits.max_buffer_size);
        (bytes / 4) as usize
    }
}

impl Renderer for SegmentRenderer {
    type Moment = Moment;
    /// The GPU, and the format of the textures that are drawn to.
    type Device = (Gpu, wgpu::TextureFormat);
    type Target = wgpu::TextureView;
    type Still = Still;

    fn begin((gpu, format): &Self::Device) -> Result<Self, PlayError> {
        Ok(Self::new(gpu, *format)?)
    }

    fn clear((gpu, _): &Self::Device, target: &wgpu::TextureView, [r, g, b]: [f32; 3]) -> Result<(), PlayError> {
        let mut encoder = gpu.encoder();
        let color = wgpu::Color { r: r.into(), g: g.into(), b: b.into(), a: 1.0 };
        drop(blit::begin(&mut encoder, target, color));
        gpu.submit(encoder);
        Ok(gpu.check()?)
    }

    fn draw(&mut self, request: &PictureRequest<'_, Moment>, target: &wgpu::TextureView) -> Result<(), PlayError> {
        Ok(self.draw(request, target)?)
    }

    fn is_whole(&self) -> bool {
        self.is_whole()
    }

    fn begin_still(&mut self, request: &PictureRequest<'_, Moment>) -> Result<Still, PlayError> {
        Ok(self.begin_still(request)?)
    }

    fn finish_still(&mut self, still: &Still) -> Result<Option<Vec<u8>>, PlayError> {
        Ok(self.finish_still(still)?)
    }
}

fn extent([width, height]: [usize; 2]) -> wgpu::Extent3d {
    wgpu::Extent3d { width: width as u32, height: height as u32, depth_or_array_layers: 1 }
}
