//! A scene whose rows are identities: the same Gaussian has the same row at all timesteps.

use std::collections::BTreeSet;
use std::ops::Range;
use std::sync::Arc;

use tcgs_core::{Gaussians, Layout, SceneReader};

use super::Export;
use crate::PipelineError;

/// Frames of an export with one row for each Gaussian. Outside its life a Gaussian has opacity 0, and is where it was
/// first or last. If the scene does not identify its Gaussians, each timestep has those that live.
#[derive(Debug)]
pub struct Identified<'a> {
    export: &'a Export<'a>,
    frames: Range<usize>,
    /// Every Gaussian of the frames, ascending; none if rows stay as they are.
    identities: Option<Vec<usize>>,
    /// Every Gaussian as it is when it is born.
    born: Gaussians,
    /// Every Gaussian at the timestep that was read last.
    held: Gaussians,
}

impl<'a> Identified<'a> {
    pub(super) fn new(export: &'a Export<'a>, frames: Range<usize>) -> Result<Self, PipelineError> {
        let none = Gaussians::zeros_of(export.scene.layout(), 0);
        let mut identified = Self { export, frames, identities: None, born: none.clone(), held: none };
        let (mut all, mut counts) = (BTreeSet::new(), Vec::new());
        for frame in identified.frames.clone() {
            let Some(living) = export.identities(frame)? else { return Ok(identified) };
            counts.push(living.len());
            all.extend(living);
        }
        if counts.iter().any(|&count| count != all.len()) {
            let all: Vec<usize> = all.into_iter().collect();
            identified.born = identified.newborn(&all)?;
            identified.identities = Some(all);
        }
        Ok(identified)
    }

    /// Every Gaussian as it is when it is born.
    fn newborn(&self, all: &[usize]) -> Result<Gaussians, PipelineError> {
        // The part and the row of each.
        let mut places: Vec<Option<usize>> = vec![None; all.len()];
        let (mut parts, mut num_rows) = (Vec::new(), 0);
        for frame in self.frames.clone() {
            let living = self.export.identities(frame)?.unwrap_or_default();
            let mut rows = Vec::new();
            for (row, identity) in living.iter().enumerate() {
                let place = &mut places[all.binary_search(identity).expect("all were collected")];
                if place.is_none() {
                    *place = Some(num_rows);
                    num_rows += 1;
                    rows.push(row);
                }
            }
            if !rows.is_empty() {
                parts.push(self.export.gaussians(frame)?.select(&rows));
            }
        }
        let order: Vec<usize> = places.into_iter().flatten().collect();
        Ok(Gaussians::concat(self.export.scene.layout(), &parts).select(&order))
    }
}

impl SceneReader for Identified<'_> {
    type Error = PipelineError;

    fn layout(&self) -> &Arc<Layout> {
        SceneReader::layout(self.export.scene)
    }

    fn num_timesteps(&self) -> usize {
        self.frames.len()
    }

    fn num_gaussians_at(&self, timestep: usize) -> usize {
        let of_scene = || SceneReader::num_gaussians_at(self.export.scene, self.frames.start + timestep);
        self.identities.as_ref().map_or_else(of_scene, Vec::len)
    }

    /// Timesteps are read in order, from 0: after its death a Gaussian keeps the place that it had last.
    fn at(&mut self, timestep: usize) -> Result<Gaussians, PipelineError> {
        let frame = self.frames.start + timestep;
        let gaussians = self.export.gaussians(frame)?;
        let Some(all) = &self.identities else { return Ok(gaussians) };
        if timestep == 0 {
            self.held = self.born.clone();
        }
        self.held.logit_opacities_mut().fill(f32::NEG_INFINITY);
        let mut rows: Vec<usize> = (0..all.len()).collect();
        for (row, identity) in self.export.identities(frame)?.unwrap_or_default().iter().enumerate() {
            rows[all.binary_search(identity).expect("all were collected")] = all.len() + row;
        }
        let layout = Arc::clone(gaussians.layout());
        self.held = Gaussians::concat(&layout, &[self.held.clone(), gaussians]).select(&rows);
        Ok(self.held.clone())
    }
}
