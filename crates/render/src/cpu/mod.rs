//! The CPU renderer: tiles over threads, lanes over pixels, the same bits for any number of threads.
//!
//! Sums that could depend on the order of threads use a fixed order: a tile writes the gradients of its pairs, then
//! each Gaussian adds up its own pairs in tile order.

mod blend;
mod rasterize;
mod tiles;

use std::convert::Infallible;
use std::sync::Arc;
use std::time::Instant;

use rayon::prelude::*;
use tcgs_core::{Activated, ActivatedGrads, Camera, Image};

use self::rasterize::{TileImage, num_learned, rasterize_bwd, rasterize_fwd, rasterize_weights};
use self::tiles::{Locked, Splat, Tiles};
pub use self::tiles::{count_pairs, gaussians_reaching, tiles_reached};
use crate::project::{SplatCamera, kept_opacity_vjp, project_vjp};
use crate::settings::{COLOR_CHANNELS, MAX_CHANNELS};
use crate::tiling::{PAIR_GRADS, TILE, tile_grid};
use crate::{Draw, Laps, PairCounts, Rasterizer, RenderGrads, RenderOutput, RenderSettings, TileMask};

/// The renderer on the CPU. It uses all threads of rayon's pool and gives the same bits for any number of them. It
/// never fails.
///
/// ```
/// use tcgs_core::{Camera, Gaussians, activate};
/// use tcgs_render::{CpuRasterizer, Rasterizer, RenderSettings};
///
/// let mut gaussians = Gaussians::zeros(1);
/// gaussians.quats_mut()[0] = [1.0, 0.0, 0.0, 0.0];
/// gaussians.colors_mut()[0] = [1.0, 0.5, 0.0];
/// let camera = Camera::look_at([0.0, 0.0, -5.0], [0.0; 3], [0.0, -1.0, 0.0], 50.0, 64, 48);
/// // The renderer on the CPU never fails: its error is `Infallible`.
/// let Ok((output, _)) = CpuRasterizer.forward(&activate(&gaussians), &camera, &RenderSettings::default());
/// let center = 24 * 64 + 32;
/// assert!((output.image.plane(0)[center] - 0.5).abs() < 1e-2); // opacity ½, colour 1
/// ```
#[derive(Clone, Copy, Debug, Default)]
pub struct CpuRasterizer;

/// The splats of one rendering, sorted for each tile. [`CpuRasterizer::forward_in`] saves them for
/// [`CpuRasterizer::backward_in`].
#[derive(Debug)]
pub struct CpuTiles(Tiles);

/// Some tiles of a view, and the splats there of Gaussians that stay the same from one [`CpuRasterizer::forward_in`] to
/// the next. They are projected and sorted once.
#[derive(Clone, Debug)]
pub struct CpuLocked {
    tiles: TileMask,
    splats: Locked,
}

impl CpuLocked {
    /// - `moving`: indices of the Gaussians that may change; all others are locked
    ///
    /// # Panics
    /// If `tiles` is not of the camera's size.
    pub fn new(gaussians: &Activated, camera: &Camera, tiles: TileMask, moving: Vec<u32>) -> Self {
        assert_eq!(tiles.grid(), tile_grid(camera.width, camera.height), "a mask of another image's tiles");
        Self { splats: Locked::new(gaussians, camera, &tiles, moving), tiles }
    }

    /// The tiles.
    pub fn tiles(&self) -> &TileMask {
        &self.tiles
    }
}

/// What [`CpuRasterizer::forward_in`] draws.
#[derive(Clone, Copy, Debug)]
pub enum Scope<'a> {
    /// The whole image.
    Whole,
    /// Some tiles.
    Tiles(&'a TileMask),
    /// The tiles of a view, where all Gaussians but the moving ones are as they were.
    Locked(&'a CpuLocked),
}

impl<'a> Scope<'a> {
    fn tiles(self) -> Option<&'a TileMask> {
        match self {
            Self::Whole => None,
            Self::Tiles(tiles) => Some(tiles),
            Self::Locked(locked) => Some(&locked.tiles),
        }
    }

    fn locked(self) -> Option<&'a Locked> {
        match self {
            Self::Locked(locked) => Some(&locked.splats),
            Self::Whole | Self::Tiles(_) => None,
        }
    }
}

/// State that the CPU's forward saves for its backward.
#[derive(Debug)]
pub struct CpuSaved {
    tiles: CpuTiles,
    image: Image,
}

impl CpuSaved {
    /// Numbers of pairs and splats in the image.
    pub fn counts(&self) -> PairCounts {
        let tiles = &self.tiles.0;
        PairCounts { pairs: tiles.pairs.len(), splats: tiles.splats.len() }
    }
}

macro_rules! with_channels {
    ($channels:expr, $f:ident($($argument:expr),*)) => {
        match $channels {
            1 => $f::<1>($($argument),*),
            2 => $f::<2>($($argument),*),
            3 => $f::<3>($($argument),*),
            4 => $f::<4>($($argument),*),
            5 => $f::<5>($($argument),*),
            6 => $f::<6>($($argument),*),
            7 => $f::<7>($($argument),*),
            8 => $f::<8>($($argument),*),
            other => panic!("{other} channels, expected 1 to {MAX_CHANNELS}"),
        }
    };
}

impl CpuRasterizer {
    /// [`Rasterizer::forward`] with a stopwatch.
    ///
    /// - `laps`: gets the stages `project`, `sort` and `rasterize`
    ///
    /// # Panics
    /// As [`Rasterizer::forward`].
    pub fn timed_forward(
        &self,
        gaussians: &Activated,
        camera: &Camera,
        settings: &RenderSettings,
        laps: &mut Laps,
    ) -> (RenderOutput, CpuSaved) {
        let mut image = Image::filled(camera.width, camera.height, gaussians.num_channels, 0.0);
        let mut transmittance = vec![0.0; camera.width * camera.height];
        let passed = Some(&mut transmittance[..]);
        let tiles = Self::draw_into(gaussians, camera, settings, Scope::Whole, &mut image, passed, laps);
        let output = RenderOutput { image, transmittance };
        let image = output.image.clone();
        laps.lap("rasterize");
        (output, CpuSaved { tiles, image })
    }

    /// Renders into an image that the caller keeps. Every pixel that it draws has the same bits as from
    /// [`Rasterizer::forward`].
    ///
    /// - `scope`: what to draw
    /// - `image`: `[C, H, W]`, overwritten there, unchanged elsewhere
    /// - `laps`: gets the stages `project`, `sort` and `rasterize`
    ///
    /// # Panics
    /// As [`Rasterizer::forward`]; if `scope` or `image` is not of the camera's size.
    pub fn forward_in(
        &self,
        gaussians: &Activated,
        camera: &Camera,
        settings: &RenderSettings,
        scope: Scope<'_>,
        image: &mut Image,
        laps: &mut Laps,
    ) -> CpuTiles {
        let tiles = Self::draw_into(gaussians, camera, settings, scope, image, None, laps);
        laps.lap("rasterize");
        tiles
    }

    /// Draws into an image, and likewise the transmittance.
    fn draw_into(
        gaussians: &Activated,
        camera: &Camera,
        settings: &RenderSettings,
        scope: Scope<'_>,
        image: &mut Image,
        transmittance: Option<&mut [f32]>,
        laps: &mut Laps,
    ) -> CpuTiles {
        let n = gaussians.num_gaussians();
        let lengths = [gaussians.quats.len(), gaussians.scales.len(), gaussians.opacities.len()];
        assert_eq!(lengths, [n; 3], "quats, scales and opacities against {n} means");
        let channels = gaussians.num_channels;
        assert_eq!(gaussians.colors.len(), n * channels, "colors against [{n}, {channels}]");
        let behind = gaussians.background.len();
        assert!(behind <= channels, "a background of {behind} channels behind Gaussians of {channels}");
        let settings = &settings.clone().or_background(&gaussians.background);
        assert_eq!(image.shape(), [channels, camera.height, camera.width], "the image to draw into");
        let (grid, mask) = (tile_grid(camera.width, camera.height), scope.tiles());
        assert!(mask.is_none_or(|mask| mask.grid() == grid), "a mask of another image's tiles");
        let tiles = Tiles::new(gaussians, camera, mask, scope.locked(), laps);
        let numbers: Vec<usize> = match mask {
            Some(mask) => mask.iter().collect(),
            None => (0..grid[0] * grid[1]).collect(),
        };
        with_channels!(channels, draw(&tiles, &numbers, &gaussians.colors, settings, image, transmittance));
        CpuTiles(tiles)
    }

    /// [`Rasterizer::backward`] with a stopwatch.
    ///
    /// - `laps`: gets the stages `rasterize backward` and `project backward`
    ///
    /// # Panics
    /// As [`Rasterizer::backward`].
    pub fn timed_backward(
        &self,
        gaussians: &Activated,
        camera: &Camera,
        settings: &RenderSettings,
        saved: &CpuSaved,
        v_image: &Image,
        laps: &mut Laps,
    ) -> RenderGrads {
        self.backward_in(gaussians, camera, settings, &saved.tiles, &saved.image, v_image, None, laps)
    }

    /// Gradients of [`Self::forward_in`] through the pixels of the drawn tiles.
    ///
    /// - `gaussians`, `camera`, `settings`: as given to `forward_in`
    /// - `image`: `[C, H, W]`, as `forward_in` left it
    /// - `v_image`: `[C, H, W]`, gradient to the image; read only in the drawn tiles
    /// - `wanted`: `[N]`, the Gaussians whose gradients are computed, all others' being 0; `None` for all
    /// - `laps`: gets the stages `rasterize backward` and `project backward`
    ///
    /// # Panics
    /// If `image` or `v_image` has a different shape from the drawn image, `wanted` another length than `N`, or
    /// `settings.statistic_channels` another value than its documented ones.
    #[allow(clippy::too_many_arguments, reason = "a forward pass, its results, and the gradient to them")]
    pub fn backward_in(
        &self,
        gaussians: &Activated,
        camera: &Camera,
        settings: &RenderSettings,
        tiles: &CpuTiles,
        image: &Image,
        v_image: &Image,
        wanted: Option<&[bool]>,
        laps: &mut Laps,
    ) -> RenderGrads {
        let drawn = [gaussians.num_channels, camera.height, camera.width];
        assert_eq!([image.shape(), v_image.shape()], [drawn; 2], "image and v_image against what was drawn");
        let (counted, channels) = (settings.statistic_channels, gaussians.num_channels);
        let is_known = [0, COLOR_CHANNELS].contains(&counted) || counted >= channels;
        assert!(is_known, "a statistic of {counted} of {channels} channels, expected 0, {COLOR_CHANNELS} or all");
        let n = gaussians.num_gaussians();
        assert_eq!(wanted.map_or(n, <[bool]>::len), n, "`wanted` against the Gaussians");
        let (tiles, colors) = (&tiles.0, &gaussians.colors);
        let num_learned = num_learned(settings, gaussians.num_channels);
        let stride = PAIR_GRADS + num_learned;
        // Each tile's gradients are allocated by the thread that fills them, because one thread zeroes memory more
        // slowly than several.
        let v_pairs: Vec<Vec<f32>> = (0..tiles.starts.len() - 1)
            .into_par_iter()
            .with_max_len(1)
            .map(|tile| {
                let mut v_pairs = vec![0.0; tiles.pairs_of(tile).len() * stride];
                if !v_pairs.is_empty() {
                    with_channels!(
                        gaussians.num_channels,
                        rasterize_bwd(tiles, tile, colors, settings, image, v_image, wanted, &mut v_pairs)
                    );
                }
                v_pairs
            })
            .collect();
        laps.lap("rasterize backward");
        let grads = gather(gaussians, camera, tiles, wanted, num_learned, &v_pairs);
        laps.lap("project backward");
        grads
    }
}

impl CpuTiles {
    /// Projects Gaussians and sorts them for all tiles of an image.
    ///
    /// # Panics
    /// As [`Rasterizer::forward`].
    pub fn new(gaussians: &Activated, camera: &Camera) -> Self {
        Self(Tiles::new(gaussians, camera, None, None, &mut Laps::begin()))
    }

    /// Draws the Gaussians in other colours than their own: the picture of [`Rasterizer::forward`], on black.
    ///
    /// - `colors`: `[N, C]`
    ///
    /// # Panics
    /// If `colors` holds another number of values.
    pub fn draw(&self, colors: &[f32], num_channels: usize) -> Image {
        let tiles = &self.0;
        assert_eq!(colors.len(), tiles.num_gaussians * num_channels, "colors of all Gaussians");
        let mut image = Image::filled(tiles.size[0], tiles.size[1], num_channels, 0.0);
        let numbers: Vec<usize> = (0..tiles.grid[0] * tiles.grid[1]).collect();
        let settings = &RenderSettings::default();
        with_channels!(num_channels, draw(tiles, &numbers, colors, settings, &mut image, None));
        image
    }

    /// The blending weight of every Gaussian, summed over pixels: the number of pixels that it would fill alone.
    ///
    /// The gradient of `Σ pixels v · picture` to a Gaussian's colour is `Σ pixels v · weight`.
    ///
    /// - `shares`: `[C, H, W]` of the camera's size, each pixel's weight in each of `C` sums
    /// - returns: `[N, C]`, pixels
    ///
    /// # Panics
    /// If `shares` is of another size.
    ///
    /// ```
    /// use tcgs_core::{Activated, Camera, Image};
    /// use tcgs_render::CpuTiles;
    /// let camera = Camera::look_at([0.0, 0.0, -3.0], [0.0; 3], [0.0, -1.0, 0.0], 50.0, 64, 48);
    /// // Two behind each other: the first takes nine tenths of every pixel, and leaves a tenth of the second's nine.
    /// let two = Activated {
    ///     means: vec![[0.0; 3], [0.0, 0.0, 1.0]],
    ///     quats: vec![[1.0, 0.0, 0.0, 0.0]; 2],
    ///     scales: vec![[100.0, 100.0, 0.01]; 2],
    ///     opacities: vec![0.9; 2],
    ///     colors: vec![0.0; 6],
    ///     num_channels: 3,
    ///     ..Activated::default()
    /// };
    /// let weights = CpuTiles::new(&two, &camera).weights(&Image::filled(64, 48, 1, 1.0));
    /// assert!((weights[0] / (64.0 * 48.0) - 0.9).abs() < 0.01 && (weights[1] / weights[0] - 0.1).abs() < 0.01);
    /// ```
    pub fn weights(&self, shares: &Image) -> Vec<f32> {
        let (tiles, channels) = (&self.0, shares.num_channels);
        assert_eq!([shares.width, shares.height], tiles.size, "shares of all pixels");
        let of_pairs: Vec<Vec<f32>> = (0..tiles.starts.len() - 1)
            .into_par_iter()
            .with_max_len(1)
            .map(|tile| {
                let mut sums = vec![0.0; tiles.pairs_of(tile).len() * channels];
                if !sums.is_empty() {
                    with_channels!(channels, rasterize_weights(tiles, tile, shares, &mut sums));
                }
                sums
            })
            .collect();
        let mut weights = vec![0.0; tiles.num_gaussians * channels];
        for (splat, ends) in tiles.splats.iter().zip(tiles.splat_starts.windows(2)) {
            let weights = &mut weights[splat.gaussian as usize * channels..][..channels];
            for &[tile, position] in &tiles.splat_pairs[ends[0] as usize..ends[1] as usize] {
                let of_pair = &of_pairs[tile as usize][position as usize * channels..][..channels];
                weights.iter_mut().zip(of_pair).for_each(|(sum, value)| *sum += value);
            }
        }
        weights
    }
}

impl Rasterizer for CpuRasterizer {
    type Saved = CpuSaved;
    type Error = Infallible;

    fn forward(
        &self,
        gaussians: &Activated,
        camera: &Camera,
        settings: &RenderSettings,
    ) -> Result<(RenderOutput, CpuSaved), Infallible> {
        Ok(self.timed_forward(gaussians, camera, settings, &mut Laps::begin()))
    }

    fn backward(
        &self,
        gaussians: &Activated,
        camera: &Camera,
        settings: &RenderSettings,
        saved: &CpuSaved,
        v_image: &Image,
    ) -> Result<RenderGrads, Infallible> {
        Ok(self.timed_backward(gaussians, camera, settings, saved, v_image, &mut Laps::begin()))
    }
}

impl Draw for CpuRasterizer {
    type Error = Infallible;

    fn name(&self) -> String {
        format!("cpu, {} threads", rayon::current_num_threads())
    }

    fn draw(
        &self,
        gaussians: &Arc<Activated>,
        camera: &Camera,
        settings: &RenderSettings,
    ) -> Result<(RenderOutput, f64), Infallible> {
        let begin = Instant::now();
        let (output, _) = self.forward(gaussians, camera, settings)?;
        Ok((output, begin.elapsed().as_secs_f64() * 1e3))
    }
}

/// Draws some tiles into an image and, if wanted, their transmittance.
///
/// - `numbers`: indices of the tiles to draw
fn draw<const C: usize>(
    tiles: &Tiles,
    numbers: &[usize],
    colors: &[f32],
    settings: &RenderSettings,
    image: &mut Image,
    transmittance: Option<&mut [f32]>,
) {
    let (width, height) = (image.width, image.height);
    let drawn: Vec<TileImage<C>> = numbers
        .par_iter()
        .with_max_len(1)
        .map(|&tile| rasterize_fwd(tiles, tile, colors, width, height, settings))
        .collect();
    // Bands of a tile's height: those of all channels, then those of the transmittance.
    let bands = image.data.par_chunks_mut(width * height).enumerate().flat_map(|(channel, plane)| {
        plane.par_chunks_mut(width * TILE).enumerate().map(move |(row, band)| (Some(channel), row, band))
    });
    let of_transmittance = transmittance
        .into_par_iter()
        .flat_map(|plane| plane.par_chunks_mut(width * TILE).enumerate().map(|(row, band)| (None, row, band)));
    bands.chain(of_transmittance).for_each(|(channel, row, band)| {
        let first = numbers.partition_point(|tile| tile / tiles.grid[0] < row);
        for (&tile, drawn) in
            numbers.iter().zip(&drawn).skip(first).take_while(|(tile, _)| **tile / tiles.grid[0] == row)
        {
            let x = tile % tiles.grid[0] * TILE;
            let count = TILE.min(width - x);
            let plane = channel.map_or(&drawn.transmittance, |channel| &drawn.planes[channel]);
            for (line, pixels) in band.chunks_exact_mut(width).zip(plane.chunks_exact(TILE)) {
                line[x..x + count].copy_from_slice(&pixels[..count]);
            }
        }
    });
}

/// Gaussians, or splats, that a task handles together. It copies the sums of all its Gaussians before it takes the
/// first through the projection. The sums lie far apart, and a loop that only copies can wait for many cache misses at
/// once.
const GATHERED: usize = 256;

/// Adds up the pairs of each Gaussian and takes the sums back through the projection.
///
/// - `wanted`: as for [`CpuRasterizer::backward_in`]
/// - `num_learned`: number of channels in `v_pairs`
/// - `v_pairs`: gradients of the pairs, one array per tile
fn gather(
    gaussians: &Activated,
    camera: &Camera,
    tiles: &Tiles,
    wanted: Option<&[bool]>,
    num_learned: usize,
    v_pairs: &[Vec<f32>],
) -> RenderGrads {
    let (n, channels) = (gaussians.num_gaussians(), gaussians.num_channels);
    let stride = PAIR_GRADS + num_learned;
    let splat_camera = SplatCamera::new(camera);
    let half_size = [0.5 * camera.width as f32, 0.5 * camera.height as f32];
    let is_wanted = |splat: &Splat| wanted.is_none_or(|wanted| wanted[splat.gaussian as usize]);
    let mut splat_of = vec![u32::MAX; n];
    for (index, splat) in tiles.splats.iter().enumerate() {
        if is_wanted(splat) {
            splat_of[splat.gaussian as usize] = index as u32;
        }
    }
    // In the order of depths the pairs of each tile follow one another, so their cache lines are still at hand.
    let sums: Vec<Vec<f32>> = (tiles.splats.par_chunks(GATHERED).enumerate())
        .map(|(chunk, splats)| {
            let mut sums = vec![0.0; splats.len() * stride];
            for (i, (sums, splat)) in sums.chunks_exact_mut(stride).zip(splats).enumerate() {
                let ends = &tiles.splat_starts[chunk * GATHERED + i..][..2];
                let pairs = if is_wanted(splat) { ends[0] as usize..ends[1] as usize } else { 0..0 };
                for &[tile, position] in &tiles.splat_pairs[pairs] {
                    let v_pair = &v_pairs[tile as usize][position as usize * stride..][..stride];
                    sums.iter_mut().zip(v_pair).for_each(|(sum, value)| *sum += value);
                }
            }
            sums
        })
        .collect();
    let mut grads = RenderGrads {
        activated: ActivatedGrads {
            v_means: vec![[0.0; 3]; n],
            v_quats: vec![[0.0; 4]; n],
            v_scales: vec![[0.0; 3]; n],
            v_opacities: vec![0.0; n],
            v_colors: vec![0.0; n * channels],
        },
        v_means2d_ndc: vec![[0.0; 2]; n],
        visible: vec![false; n],
    };
    let a = &mut grads.activated;
    (
        splat_of.par_chunks(GATHERED),
        a.v_means.par_chunks_mut(GATHERED),
        a.v_quats.par_chunks_mut(GATHERED),
        a.v_scales.par_chunks_mut(GATHERED),
        a.v_opacities.par_chunks_mut(GATHERED),
        a.v_colors.par_chunks_mut(GATHERED * channels),
        grads.v_means2d_ndc.par_chunks_mut(GATHERED),
        grads.visible.par_chunks_mut(GATHERED),
    )
        .into_par_iter()
        .enumerate()
        .for_each(|(chunk, (splats, v_means, v_quats, v_scales, v_opacities, v_colors, v_ndc, visible))| {
            let mut own = [[0.0; PAIR_GRADS]; GATHERED];
            for (i, &splat) in splats.iter().enumerate().filter(|(_, splat)| **splat != u32::MAX) {
                let row = &sums[splat as usize / GATHERED][splat as usize % GATHERED * stride..][..stride];
                let (of_splat, of_colors) = row.split_at(PAIR_GRADS);
                own[i].copy_from_slice(of_splat);
                v_colors[i * channels..][..num_learned].copy_from_slice(of_colors);
            }
            for (i, _) in splats.iter().enumerate().filter(|(_, splat)| **splat != u32::MAX) {
                let gaussian = chunk * GATHERED + i;
                let [x, y, xx, xy, yy, opacity, statistic_x, statistic_y] = own[i];
                let (mut v_conic, mut v_opacity) = ([xx, xy, yy], opacity);
                if gaussians.is_antialiased {
                    let splat = &tiles.splats[splat_of[gaussian] as usize];
                    let kept = splat.opacity / gaussians.opacities[gaussian];
                    let v = kept_opacity_vjp(splat.conic, kept, v_opacity * gaussians.opacities[gaussian]);
                    (0..3).for_each(|d| v_conic[d] += v[d]);
                    v_opacity *= kept;
                }
                visible[i] = true;
                v_opacities[i] = v_opacity;
                v_ndc[i] = [statistic_x * half_size[0], statistic_y * half_size[1]];
                (v_means[i], v_quats[i], v_scales[i]) = project_vjp(
                    gaussians.means[gaussian],
                    gaussians.quats[gaussian],
                    gaussians.scales[gaussian],
                    &splat_camera,
                    [x, y],
                    v_conic,
                );
            }
        });
    grads
}
