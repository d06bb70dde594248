//! The renderer without a device: its buffer sizes, the uniform of a view, the shaders.

use bytemuck::{Pod, Zeroable};
use tcgs_core::Camera;

use super::{MAX_GROUPS_X, SORT_BLOCK, WORKGROUP, Wgsl, activated_len, sort_source};
use crate::project::SplatCamera;
use crate::settings::{self, MAX_CHANNELS, RenderSettings};
use crate::tiling::{EXTENT_FACTOR, EXTENT_MARGIN_PX, PAIR_GRADS, TILE, tile_grid};

/// Splats of a bucket. Backward gives each bucket of a tile a workgroup with one thread per splat; forward saves the
/// blended colour and transmittance before each bucket.
pub const BUCKET: usize = 32;

/// Flag in a splat's tile count: its bounds hold a pixel, whether or not a tile is reached.
pub const VISIBLE: u32 = 0x8000_0000;

/// Capacity of a renderer's buffers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Capacity {
    /// `N`, exactly.
    pub num_gaussians: usize,
    /// `C`, 1 to 8, exactly.
    pub num_channels: usize,
    /// Pixels of the largest image.
    pub num_pixels: usize,
    /// Most tiles of an image that are drawn.
    pub num_tiles: usize,
    /// Most pairs of a tile and a splat that reaches it.
    pub num_pairs: usize,
    /// Whether there is room for the backward pass.
    pub backward: bool,
}

impl Capacity {
    /// Room for images of any of the cameras, and a first guess of the pairs: two per Gaussian and sixteen per tile.
    pub fn new<'a>(
        num_gaussians: usize,
        num_channels: usize,
        cameras: impl IntoIterator<Item = &'a Camera>,
        backward: bool,
    ) -> Self {
        let (mut num_pixels, mut num_tiles) = (1, 1);
        for camera in cameras {
            num_pixels = num_pixels.max(camera.width * camera.height);
            let [columns, rows] = tile_grid(camera.width, camera.height);
            num_tiles = num_tiles.max(columns * rows);
        }
        let num_pairs = 2 * num_gaussians + 16 * num_tiles;
        Self { num_gaussians, num_channels, num_pixels, num_tiles, num_pairs, backward }
    }

    /// Whether a renderer of this capacity can draw a request for another capacity.
    pub fn serves(&self, wanted: &Self) -> bool {
        self.num_gaussians == wanted.num_gaussians
            && self.num_channels == wanted.num_channels
            && self.num_pixels >= wanted.num_pixels
            && self.num_tiles >= wanted.num_tiles
            && self.num_pairs >= wanted.num_pairs
            && self.backward >= wanted.backward
    }

    /// Most buckets: each tile's last one may be partly empty.
    pub fn num_buckets(&self) -> usize {
        self.num_pairs / BUCKET + self.num_tiles
    }

    /// Bits of the largest tile number; at least one.
    pub fn tile_bits(&self) -> u32 {
        (usize::BITS - self.num_tiles.saturating_sub(1).leading_zeros()).max(1)
    }

    /// 32-bit values of the activated Gaussians, and of their gradients: `[(11 + C) N]`.
    pub fn activated_len(&self) -> usize {
        activated_len(self.num_gaussians, self.num_channels)
    }

    /// 32-bit values of the image: `[C + 1, H, W]`, colours, then transmittance.
    pub fn image_len(&self) -> usize {
        (self.num_channels + 1) * self.num_pixels
    }

    /// 32-bit values of the tiles' table: `[2 (T + 1) + buckets]`, first pairs, first buckets, tiles of buckets.
    pub fn tiles_len(&self) -> usize {
        2 * (self.num_tiles + 1) + self.num_buckets()
    }

    /// 32-bit values of forward's checkpoints before each bucket, for every pixel of its tile:
    /// `[buckets, 1 + C, PIXELS]`.
    pub fn checkpoints_len(&self) -> usize {
        self.num_buckets() * (1 + self.num_channels) * TILE * TILE
    }

    /// 32-bit values of the gradients of pairs: `[pairs, PAIR_GRADS + C]`.
    pub fn pair_grads_len(&self) -> usize {
        self.num_pairs * (PAIR_GRADS + self.num_channels)
    }
}

/// The part of a scene and an image that a view draws, and the Gaussians that get a gradient.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq, Pod, Zeroable)]
pub struct ViewPart {
    /// Gaussians that may be drawn.
    pub num_listed: u32,
    /// Rows of gradients, for the first Gaussians.
    pub num_rows: u32,
    /// Number of leading rows that get a gradient; the other rows get zeros.
    pub num_active: u32,
    /// Tiles that are drawn.
    pub num_tiles: u32,
    /// Offset of the view's lists; `listed.wgsl` describes their contents.
    pub lists_at: u32,
}

/// One view: the camera and the sizes, as `View` in `view.wgsl` reads them.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct ViewUniform {
    /// Rows of `camera_from_world`.
    pub rows: [[f32; 4]; 3],
    /// Focal lengths, pixels.
    pub focal: [f32; 2],
    /// Principal point, pixels.
    pub principal: [f32; 2],
    /// Least `x/z` and `y/z` at which the projection is linearised.
    pub slope_min: [f32; 2],
    /// Greatest `x/z` and `y/z` at which the projection is linearised.
    pub slope_max: [f32; 2],
    /// Width and height of the image, pixels.
    pub size: [u32; 2],
    /// Tiles in a row and in a column.
    pub grid: [u32; 2],
    /// `N`
    pub num_gaussians: u32,
    /// Capacity of the buffers, pairs.
    pub pair_capacity: u32,
    /// Leading channels that the densification statistic counts.
    pub statistic_channels: u32,
    /// The part of the scene and of the image that is drawn.
    pub part: ViewPart,
    /// 1 if splats are antialiased, else 0.
    pub antialiased: u32,
    /// Padding to a multiple of 16 bytes.
    pub padding: [u32; 3],
    /// Colour behind everything, one value per channel.
    pub background: [f32; MAX_CHANNELS],
}

impl ViewUniform {
    /// A view of everything from `camera`, for a renderer of `capacity`.
    ///
    /// - `antialiased`: [`Activated::is_antialiased`](tcgs_core::Activated) of the drawn Gaussians
    ///
    /// # Panics
    /// If the image is larger than there is room for.
    pub fn new(camera: &Camera, settings: &RenderSettings, antialiased: bool, capacity: &Capacity) -> Self {
        let [columns, rows] = tile_grid(camera.width, camera.height);
        let num_gaussians = capacity.num_gaussians as u32;
        let part = ViewPart {
            num_listed: num_gaussians,
            num_rows: num_gaussians,
            num_active: num_gaussians,
            num_tiles: (columns * rows) as u32,
            lists_at: 0,
        };
        Self::of_part(camera, settings, antialiased, capacity, part)
    }

    /// A view of a part from `camera`, for a renderer of `capacity`; otherwise as [`Self::new`].
    ///
    /// # Panics
    /// If the image or the part is larger than there is room for.
    pub fn of_part(
        camera: &Camera,
        settings: &RenderSettings,
        antialiased: bool,
        capacity: &Capacity,
        part: ViewPart,
    ) -> Self {
        let (width, height) = (camera.width, camera.height);
        let grid = tile_grid(width, height);
        assert!(
            width * height <= capacity.num_pixels && part.num_tiles as usize <= capacity.num_tiles,
            "{} tiles of an image of {width}x{height}, room for {} tiles and {} pixels",
            part.num_tiles,
            capacity.num_tiles,
            capacity.num_pixels
        );
        assert!(
            part.num_active <= part.num_rows && part.num_rows.max(part.num_listed) as usize <= capacity.num_gaussians,
            "{part:?}, room for {} Gaussians",
            capacity.num_gaussians
        );
        let SplatCamera { pinhole, slope_min, slope_max } = SplatCamera::<f32>::new(camera);
        let row = |i: usize| {
            let [x, y, z] = pinhole.rotation[i];
            [x, y, z, pinhole.translation[i]]
        };
        Self {
            rows: [row(0), row(1), row(2)],
            focal: pinhole.focal,
            principal: pinhole.principal,
            slope_min,
            slope_max,
            size: [width as u32, height as u32],
            grid: grid.map(|x| x as u32),
            num_gaussians: capacity.num_gaussians as u32,
            pair_capacity: capacity.num_pairs as u32,
            statistic_channels: settings.statistic_channels as u32,
            part,
            antialiased: u32::from(antialiased),
            padding: [0; 3],
            background: settings.background.unwrap_or_default(),
        }
    }
}

/// The common start of every shader of the renderer: the constants of [`settings`], of the tiling and of this module.
///
/// - `num_channels`: number of colour channels, 1 to 8
pub(super) fn source(num_channels: usize) -> Wgsl {
    Wgsl::new()
        .constant("NEAR", settings::NEAR as f32)
        .constant("BLUR_VARIANCE", settings::BLUR_VARIANCE as f32)
        .constant("MIN_ALPHA", settings::MIN_ALPHA as f32)
        .constant("MAX_ALPHA", settings::MAX_ALPHA as f32)
        .constant("MIN_TRANSMITTANCE", settings::MIN_TRANSMITTANCE as f32)
        .constant("EXTENT_FACTOR", EXTENT_FACTOR)
        .constant("EXTENT_MARGIN_PX", EXTENT_MARGIN_PX)
        .constant("CHANNELS", num_channels)
        .constant("TILE", TILE)
        .constant("PIXELS", TILE * TILE)
        .constant("PAIR_GRADS", PAIR_GRADS)
        .constant("BUCKET", BUCKET)
        .constant("VISIBLE", VISIBLE)
        .constant("WORKGROUP", WORKGROUP)
        .constant("MAX_GROUPS_X", MAX_GROUPS_X)
        .constant("SORT_BLOCK", SORT_BLOCK)
        .activated_columns()
}

/// Sources of the renderer's shaders.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RenderSources {
    /// Kernels `project_fwd` and `project_bwd`.
    pub project: String,
    /// Kernels `bin_count`, `bin_scan`, `bin_emit`, `bin_ranges` and `bin_buckets`.
    pub bin: String,
    /// Kernel `rasterize_fwd`.
    pub rasterize_fwd: String,
    /// Kernel `rasterize_bwd`.
    pub rasterize_bwd: String,
}

/// Set of Gaussians and tiles that the shaders draw.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Coverage {
    /// All of them.
    Whole,
    /// The ones in a view's lists: [`ViewPart`].
    Listed,
}

impl RenderSources {
    /// Assembles the shaders.
    ///
    /// - `num_channels`: number of colour channels, 1 to 8
    /// - `keeps`: whether forward saves state for backward
    pub fn new(num_channels: usize, keeps: bool, coverage: Coverage) -> Self {
        let coverage = match coverage {
            Coverage::Whole => include_str!("whole.wgsl"),
            Coverage::Listed => include_str!("listed.wgsl"),
        };
        let source = || source(num_channels).part(include_str!("view.wgsl")).part(coverage);
        let reach = include_str!("reach.wgsl");
        Self {
            project: source().part(reach).part(include_str!("project.wgsl")).finish(),
            bin: source().part(reach).part(include_str!("bin.wgsl")).finish(),
            rasterize_fwd: source().constant("KEEPS", keeps).part(include_str!("rasterize_fwd.wgsl")).finish(),
            rasterize_bwd: source().part(include_str!("rasterize_bwd.wgsl")).finish(),
        }
    }
}

/// Every shader of the renderer with its name, as a device gets it. Shaders that depend on the channels appear once for
/// colour (3) and once for colour with segmentation (5). Shaders with lists are for training and appear with
/// segmentation alone.
pub fn sources() -> Vec<(String, String)> {
    let mut sources = vec![("radix".into(), sort_source())];
    let kinds = [(3, Coverage::Whole, "3"), (5, Coverage::Whole, "5"), (5, Coverage::Listed, "listed")];
    for (num_channels, coverage, kind) in kinds {
        let RenderSources { project, bin, rasterize_fwd, rasterize_bwd } =
            RenderSources::new(num_channels, num_channels == 5, coverage);
        let named =
            [("project", project), ("bin", bin), ("rasterize_fwd", rasterize_fwd), ("rasterize_bwd", rasterize_bwd)];
        sources.extend(named.map(|(name, source)| (format!("{name}_{kind}"), source)));
    }
    sources
}
