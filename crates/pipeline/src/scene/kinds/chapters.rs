//! Runs that continue one another, as one scene over time. What does not live here: the training of a chapter
//! (`train::chapter`).

use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use tcgs_codec::CompressSettings;
use tcgs_core::{Drawable, Gaussians, Layout};

use super::run::RunContent;
use crate::PipelineError;
use crate::scene::content::MaskLogits;
use crate::scene::{OpenScene, SceneContent};

/// Chapters and the frames that each contributes.
#[derive(Debug)]
struct Chapters {
    /// Two or more runs, by their first frames.
    scenes: Vec<OpenScene>,
    /// The frames that each contributes; together, all frames of the joined scene.
    frames: Vec<Range<usize>>,
    segment_length: u32,
}

/// See [`OpenScene::join`].
///
/// - `scenes`: two or more
pub(crate) fn join(mut scenes: Vec<OpenScene>, segment_length: Option<u32>) -> Result<OpenScene, PipelineError> {
    scenes.sort_by_key(|scene| scene.frames().start);
    check(&scenes)?;
    let all = scenes[0].frames().start..scenes.last().map_or(0, |last| last.frames().end);
    let num_gaussians = scenes[0].num_gaussians_at(0);
    let settings = CompressSettings { segment_length, ..CompressSettings::default() };
    let segment_length = settings.segment_length_of(num_gaussians, all.len());
    let frames = shares(&scenes, &all, segment_length as usize);
    let first = &scenes[0];
    Ok(OpenScene {
        path: first.path.clone(),
        first_frame: first.first_frame,
        downscale: first.downscale,
        frame_rate: first.frame_rate,
        bytes: first.layout.raw_bytes(num_gaussians, all.len()),
        kind: "run folders",
        num_timesteps: all.len(),
        num_identities: first.num_identities,
        layout: Arc::clone(&first.layout),
        content: Box::new(Chapters { scenes, frames, segment_length }),
    })
}

/// The frames of each scene that count: up to the last border of segments after the next one begins, or up to its end.
fn shares(scenes: &[OpenScene], all: &Range<usize>, segment_length: usize) -> Vec<Range<usize>> {
    let mut starts = vec![all.start];
    for pair in scenes.windows(2) {
        let (later, end) = (pair[1].frames().start, pair[0].frames().end);
        // A chapter's first timestep still catches up with a distant start, so a border comes after it.
        let earliest = later.max(starts[starts.len() - 1]) + 1;
        let border = all.start + (end - all.start) / segment_length * segment_length;
        starts.push(if border >= earliest { border } else { end });
    }
    let ends = starts[1..].iter().copied().chain([all.end]);
    starts.iter().zip(ends).map(|(&start, end)| start..end).collect()
}

impl Chapters {
    fn first(&self) -> &dyn SceneContent {
        &*self.scenes[0].content
    }

    /// The chapter that shows a timestep, and the timestep's index in it.
    ///
    /// # Panics
    /// If there is no such timestep.
    fn place(&self, timestep: usize) -> (&OpenScene, usize) {
        let frame = self.frames[0].start + timestep;
        let chapter = self.frames.iter().position(|frames| frames.contains(&frame));
        let chapter = &self.scenes[chapter.expect("a timestep of the scene")];
        (chapter, frame - chapter.first_frame)
    }
}

impl SceneContent for Chapters {
    fn at(&self, timestep: usize) -> Result<Gaussians, PipelineError> {
        let (chapter, timestep) = self.place(timestep);
        chapter.at(timestep)
    }

    fn drawn(&self, timestep: usize) -> Result<Drawable, PipelineError> {
        let (chapter, timestep) = self.place(timestep);
        chapter.drawn(timestep)
    }

    fn files(&self, _: &Path) -> Vec<PathBuf> {
        self.scenes.iter().flat_map(|scene| scene.content.files(&scene.path)).collect()
    }

    fn segment_length(&self) -> Option<u32> {
        Some(self.segment_length)
    }

    fn foreground(&self, _: usize) -> Result<Option<Vec<bool>>, PipelineError> {
        self.first().foreground(0)
    }

    fn run(&self) -> Option<&RunContent> {
        self.first().run()
    }

    fn mask_logits(&self) -> MaskLogits<'_> {
        Box::new(self.scenes.iter().zip(&self.frames).flat_map(|(scene, frames)| {
            scene.content.mask_logits().skip(frames.start - scene.first_frame).take(frames.len())
        }))
    }
}

/// Whether runs, by their first frames, are chapters of one scene.
fn check(scenes: &[OpenScene]) -> Result<(), PipelineError> {
    if let Some(scene) = scenes.iter().find(|scene| scene.run().is_none()) {
        return refuse(scene, format!("is a {}", scene.kind()), "run folders where several are joined");
    }
    if let Some(scene) = scenes.iter().find(|scene| scene.lives().is_some()) {
        let expected = "the same at all timesteps where runs are joined: chapters that start from a run of one frame, \
                        or births.enabled=false and deaths.patience=0";
        return refuse(scene, "has Gaussians that are born or die", expected);
    }
    for pair in scenes.windows(2) {
        check_frames(&pair[0], &pair[1])?;
        check_gaussians(&scenes[0], &pair[1])?;
    }
    Ok(())
}

fn refuse(scene: &OpenScene, found: impl Into<String>, expected: impl Into<String>) -> Result<(), PipelineError> {
    Err(PipelineError::input(scene.path.display(), found, expected))
}

/// Whether a chapter continues the one before it.
fn check_frames(before: &OpenScene, scene: &OpenScene) -> Result<(), PipelineError> {
    let (frames, end) = (scene.frames(), before.frames().end);
    if frames.start > end {
        let expected = format!("frame {end} or an earlier one, where {} ends", before.path.display());
        return refuse(scene, format!("begins at frame {}", frames.start), expected);
    }
    if frames.end <= end {
        let expected = format!("more, since {} ends there or later", before.path.display());
        return refuse(scene, format!("ends with frame {}", frames.end - 1), expected);
    }
    Ok(())
}

/// Whether a chapter has the Gaussians of the first, at the same scale and rate.
fn check_gaussians(first: &OpenScene, scene: &OpenScene) -> Result<(), PipelineError> {
    let (found, expected) = (scene.num_gaussians_at(0), first.num_gaussians_at(0));
    let as_first = format!(
        "those of {} in the same order, since a .tcgs file has the same Gaussians at all timesteps: \
         chapters start from one run (train --start-from)",
        first.path.display()
    );
    if found != expected {
        return refuse(scene, format!("has {found} Gaussians, not {expected}"), as_first);
    }
    let constants = [first, scene].map(|scene| scene.first_checkpoint().map(|c| &c.parameters.gaussians));
    if let [Some(of_first), Some(own)] = constants
        && let Some(column) = first_difference(of_first, own)
    {
        return refuse(scene, format!("has other {column}"), as_first);
    }
    let told = [first, scene].map(|scene| (scene.downscale, scene.frame_rate));
    if told[0] != told[1] {
        let said = |(downscale, rate)| format!("downscale {downscale} and frame rate {rate}");
        let expected = format!("{} as {}", said(told[0]), first.path.display());
        return refuse(scene, format!("has {}", said(told[1])), expected);
    }
    Ok(())
}

/// Name of a column that is constant over time and differs between two scenes. Columns that vary may differ.
fn first_difference(first: &Gaussians, other: &Gaussians) -> Option<String> {
    let [a, b]: [&Layout; 2] = [first.layout(), other.layout()];
    if a != b {
        let is_background = a.background() != b.background();
        return Some(if is_background { "background" } else { "columns" }.into());
    }
    let bits = |gaussians: &Gaussians, attribute| -> Vec<u32> {
        gaussians.values(attribute).iter().map(|x| x.to_bits()).collect()
    };
    let differs = |attribute| bits(first, attribute) != bits(other, attribute);
    a.columns().iter().find(|column| !column.varies && differs(column.attribute)).map(|column| column.name.clone())
}
