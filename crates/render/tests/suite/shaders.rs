//! Every shader is valid WGSL within the limits of every browser. The check needs no GPU.

use std::fs;
use std::path::Path;

use tcgs_render::device::{Wgsl, sources};
// The compiler that the GPU code uses: its version cannot differ.
use wgpu::naga::valid::{Capabilities, ModuleInfo, ValidationFlags, Validator};
use wgpu::naga::{AddressSpace, Module, ShaderStage, front::wgsl};

/// Most storage buffers per compute shader in every browser.
const MAX_STORAGE_BUFFERS: usize = 8;
const MAX_WORKGROUP_BYTES: u32 = 16 * 1024;
const MAX_THREADS: u32 = 256;
/// Backward kernels and kernels of listed parts train, and never run in a browser; every desktop adapter allows this.
const MAX_STORAGE_BUFFERS_TRAINING: usize = 10;

fn validated(name: &str, source: &str) -> (Module, ModuleInfo) {
    let module = wgsl::parse_str(source).unwrap_or_else(|e| panic!("{}", e.emit_to_string_with_path(source, name)));
    // No capabilities (no subgroups, no atomics on floats), because a browser may lack any of them.
    let info = Validator::new(ValidationFlags::all(), Capabilities::empty())
        .validate(&module)
        .unwrap_or_else(|e| panic!("{}", e.emit_to_string_with_path(source, name)));
    (module, info)
}

#[test]
fn every_shader_is_valid_within_the_limits_of_browsers() {
    for (name, source) in sources() {
        for line in source.lines() {
            let word = line.split_whitespace().next();
            assert!(!matches!(word, Some("enable" | "requires")), "{name} asks for an extension: {line}");
        }
        let (module, info) = validated(&name, &source);
        assert!(!module.entry_points.is_empty(), "{name} has no entry point");
        for (index, entry) in module.entry_points.iter().enumerate() {
            let what = format!("{} of {name}", entry.name);
            assert_eq!(entry.stage, ShaderStage::Compute, "{what}");
            let threads: u32 = entry.workgroup_size.iter().product();
            assert!(threads <= MAX_THREADS, "{what} has {threads} threads");

            let mut num_buffers = 0;
            let mut workgroup_bytes = 0;
            for (handle, global) in module.global_variables.iter() {
                if info.get_entry_point(index)[handle].is_empty() {
                    continue;
                }
                match global.space {
                    AddressSpace::Storage { .. } => num_buffers += 1,
                    AddressSpace::WorkGroup => {
                        let size = module.types[global.ty].inner.size(module.to_ctx());
                        workgroup_bytes += size.next_multiple_of(16);
                    }
                    _ => {}
                }
            }
            let trains = entry.name.ends_with("_bwd") || name.ends_with("_listed");
            let most = if trains { MAX_STORAGE_BUFFERS_TRAINING } else { MAX_STORAGE_BUFFERS };
            assert!(num_buffers <= most, "{what} uses {num_buffers} storage buffers, at most {most}");
            assert!(workgroup_bytes <= MAX_WORKGROUP_BYTES, "{what} uses {workgroup_bytes} bytes of workgroup memory");
        }
    }
}

#[test]
fn no_shader_is_left_out() {
    let sources = sources();
    // Shared with shaders of other crates, which validate it among their own.
    let shared = Wgsl::new().harmonics().finish();
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("src/device");
    let mut num_files = 0;
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.extension().is_some_and(|extension| extension == "wgsl") {
            let text = fs::read_to_string(&path).unwrap();
            let is_used = shared.contains(&text) || sources.iter().any(|(_, source)| source.contains(&text));
            assert!(is_used, "{} is in no source", path.display());
            num_files += 1;
        }
    }
    assert!(num_files > 0);
    let mut names: Vec<&String> = sources.iter().map(|(name, _)| name).collect();
    names.sort();
    names.dedup();
    assert_eq!(names.len(), sources.len(), "names occur twice");
}

#[test]
fn what_browsers_lack_is_refused() {
    for source in [
        "@compute @workgroup_size(32) fn f(@builtin(subgroup_invocation_id) i: u32) { let sum = subgroupAdd(i); }",
        "@group(0) @binding(0) var<storage, read_write> sum: atomic<f32>;
         @compute @workgroup_size(32) fn f() { atomicAdd(&sum, 1.0); }",
    ] {
        let module = wgsl::parse_str(source).unwrap();
        assert!(Validator::new(ValidationFlags::all(), Capabilities::empty()).validate(&module).is_err(), "{source}");
    }
}
