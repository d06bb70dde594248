//! How many workgroups a dispatch has: a thread an element, in workgroups of one size, within the limits of every
//! adapter.

/// Threads of a workgroup wherever a shader has one thread an element.
pub const WORKGROUP: u32 = 256;

/// Most workgroups along x where a count of them may pass the limit of one dimension; the rest go along y.
pub const MAX_GROUPS_X: u32 = 32_768;

/// Most workgroups along one dimension of a dispatch that every adapter takes.
pub(crate) const MAX_GROUPS: usize = 65_535;

/// Most elements that have a thread each in one dispatch along x.
pub const MAX_THREADS: usize = MAX_GROUPS * WORKGROUP as usize;

/// Workgroups along x, y and z where each of `len` elements has a thread: [`WORKGROUP`] of them a workgroup.
///
/// - `len`: at most [`MAX_THREADS`]
pub fn groups_over(len: usize) -> [u32; 3] {
    [(len as u32).div_ceil(WORKGROUP), 1, 1]
}

/// Workgroups along x, y and z where `len` of them are wanted: more than [`MAX_GROUPS_X`] fill several rows, the last of
/// which may be too long. A workgroup's number is `workgroup_id.y * MAX_GROUPS_X + workgroup_id.x`; where that is not
/// below `len` it has nothing to do.
///
/// ```
/// assert_eq!(tcgs_render::device::groups_in_rows(5), [5, 1, 1]);
/// assert_eq!(tcgs_render::device::groups_in_rows(70_000), [32_768, 3, 1]);
/// ```
pub fn groups_in_rows(len: usize) -> [u32; 3] {
    let len = len as u32;
    [len.min(MAX_GROUPS_X), len.div_ceil(MAX_GROUPS_X), 1]
}
