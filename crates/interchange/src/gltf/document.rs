//! The JSON of a glTF file, as far as Gaussians need it, and the primitives that its scene shows. What does not live
//! here: the numbers of accessors.

use std::collections::BTreeMap;

use serde::Deserialize;
use tcgs_core::MAX_SH_DEGREE;

use super::placement::Placement;
use super::{EXTENSION, harmonic};

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub struct Document {
    scene: Option<usize>,
    #[serde(default)]
    scenes: Vec<Scene>,
    #[serde(default)]
    nodes: Vec<Node>,
    #[serde(default)]
    meshes: Vec<Mesh>,
    #[serde(default)]
    pub accessors: Vec<Accessor>,
    #[serde(default)]
    pub buffer_views: Vec<BufferView>,
    #[serde(default)]
    pub buffers: Vec<Buffer>,
    #[serde(default)]
    extensions_required: Vec<String>,
}

#[derive(Deserialize)]
struct Scene {
    #[serde(default)]
    nodes: Vec<usize>,
}

#[derive(Deserialize)]
struct Node {
    mesh: Option<usize>,
    #[serde(default)]
    children: Vec<usize>,
    #[serde(flatten)]
    placement: super::placement::Given,
}

#[derive(Deserialize)]
struct Mesh {
    #[serde(default)]
    primitives: Vec<Primitive>,
}

#[derive(Deserialize)]
pub struct Primitive {
    pub attributes: BTreeMap<String, usize>,
    mode: Option<u32>,
    #[serde(default)]
    extensions: Extensions,
}

#[derive(Default, Deserialize)]
struct Extensions {
    #[serde(rename = "KHR_gaussian_splatting")]
    gaussians: Option<Gaussians>,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct Gaussians {
    kernel: String,
    color_space: String,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub struct Accessor {
    pub buffer_view: Option<usize>,
    #[serde(default)]
    pub byte_offset: usize,
    pub component_type: u32,
    #[serde(default)]
    pub normalized: bool,
    pub count: usize,
    #[serde(rename = "type")]
    pub shape: String,
    pub sparse: Option<serde::de::IgnoredAny>,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub struct BufferView {
    pub buffer: usize,
    #[serde(default)]
    pub byte_offset: usize,
    pub byte_length: usize,
    pub byte_stride: Option<usize>,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub struct Buffer {
    pub uri: Option<String>,
    pub byte_length: usize,
}

/// A primitive of Gaussians where a node puts it.
pub struct Placed<'a> {
    pub primitive: &'a Primitive,
    pub placement: Placement,
}

impl Primitive {
    /// Highest degree for which all coefficients are present.
    pub fn sh_degree(&self) -> usize {
        let has = |l: usize| (0..=2 * l).all(|n| self.attributes.contains_key(&harmonic(l, n)));
        (1..=MAX_SH_DEGREE).take_while(|&l| has(l)).count()
    }
}

impl Document {
    /// The primitives of Gaussians that the scene shows.
    ///
    /// - `most`: most primitives, since each node may show all of them
    pub fn placed(&self, most: usize) -> Result<Vec<Placed<'_>>, String> {
        // Quantised positions are read; other extensions could change what numbers mean.
        let known = |name: &&String| [EXTENSION, "KHR_mesh_quantization"].contains(&&***name);
        if let Some(other) = self.extensions_required.iter().find(|name| !known(name)) {
            return Err(format!("requires the extension {other}, expected {EXTENSION} alone"));
        }
        let Some(scene) = self.scenes.get(self.scene.unwrap_or(0)) else {
            return Err("has no scene, expected one".into());
        };
        let of_gaussians = |mesh: &'_ Mesh| -> Vec<usize> {
            let primitives = mesh.primitives.iter().enumerate();
            primitives.filter(|(_, primitive)| primitive.extensions.gaussians.is_some()).map(|(i, _)| i).collect()
        };
        let of_meshes: Vec<Vec<usize>> = self.meshes.iter().map(of_gaussians).collect();
        let mut found = Vec::new();
        let mut is_met = vec![false; self.nodes.len()];
        let mut waiting: Vec<(usize, Placement)> = Vec::new();
        waiting.extend(scene.nodes.iter().rev().map(|&root| (root, Placement::default())));
        while let Some((index, parent)) = waiting.pop() {
            let node = self.nodes.get(index).ok_or_else(|| format!("has no node {index}, expected one"))?;
            if std::mem::replace(&mut is_met[index], true) {
                return Err(format!("comes to node {index} twice, expected a tree of nodes"));
            }
            let placement = parent.then(&node.placement).map_err(|problem| format!("node {index} {problem}"))?;
            waiting.extend(node.children.iter().rev().map(|&child| (child, placement)));
            let Some(mesh) = node.mesh else { continue };
            let shown = of_meshes.get(mesh).ok_or_else(|| format!("has no mesh {mesh}, expected one"))?;
            if shown.len() > most - found.len() {
                return Err(format!("shows more than {most} primitives, expected fewer"));
            }
            for primitive in shown.iter().map(|&i| &self.meshes[mesh].primitives[i]) {
                if let Some(gaussians) = &primitive.extensions.gaussians {
                    check(primitive, gaussians)?;
                    found.push(Placed { primitive, placement });
                }
            }
        }
        if found.is_empty() {
            return Err(format!("shows no primitive with {EXTENSION}, expected one"));
        }
        Ok(found)
    }
}

fn check(primitive: &Primitive, Gaussians { kernel, color_space }: &Gaussians) -> Result<(), String> {
    match primitive.mode {
        Some(0) => {}
        mode => return Err(format!("has Gaussians of mode {}, expected 0", mode.unwrap_or(4))),
    }
    if kernel != "ellipse" {
        return Err(format!("has Gaussians of kernel {kernel:?}, expected \"ellipse\""));
    }
    if color_space != "srgb_rec709_display" {
        return Err(format!("has colours in {color_space:?}, expected \"srgb_rec709_display\""));
    }
    Ok(())
}
