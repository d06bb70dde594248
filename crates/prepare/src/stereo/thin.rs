//! Fewer points, evenly over space.

use rayon::prelude::*;

use super::fuse::Point;

/// Thins points to about `count` at most: the points of a cube become their mean.
///
/// Points of an earlier list are better. A cube takes only points of the first list that has any in it. A cube of a
/// later list is dropped beside a cube of an earlier one.
///
/// - `lists`: best first
pub(super) fn thin(lists: &[Vec<Point>], count: usize) -> Vec<(usize, Point)> {
    let all = || lists.iter().flatten();
    let mut edge = 1e-6;
    if all().count() > count {
        let extent = |i: usize| {
            let mut values: Vec<f32> = all().map(|point| point.position[i]).collect();
            values.sort_unstable_by(f32::total_cmp);
            values[values.len() - 1 - values.len() / 100] - values[values.len() / 100]
        };
        let size = (0..3).map(extent).fold(0.0, f32::max);
        // Few cubes come of large edges, many of small ones.
        let (mut small, mut large) = (size * 1e-4, size * 0.1);
        for _ in 0..14 {
            edge = (small * large).sqrt();
            if cubes(lists, edge).len() > count { small = edge } else { large = edge }
        }
        edge = large;
    }
    cubes(lists, edge)
}

fn cubes(lists: &[Vec<Point>], edge: f32) -> Vec<(usize, Point)> {
    let key = |point: &Point| point.position.map(|x| (x / edge).floor() as i64);
    let mut keyed: Vec<([i64; 3], usize, usize)> = lists
        .par_iter()
        .enumerate()
        .flat_map(|(list, points)| points.par_iter().enumerate().map(move |(i, point)| (key(point), list, i)))
        .collect();
    keyed.par_sort_unstable();
    let merged: Vec<([i64; 3], usize, Point)> = keyed
        .chunk_by(|a, b| a.0 == b.0)
        .map(|cube| {
            let list = cube[0].1;
            let members = cube.iter().take_while(|member| member.1 == list).map(|member| &lists[list][member.2]);
            let (mut sum, mut color, mut count, mut foreground) = ([0.0; 3], [0.0; 3], 0.0, 0.0);
            for point in members {
                for i in 0..3 {
                    sum[i] += point.position[i];
                    color[i] += point.color[i];
                }
                count += 1.0;
                foreground += f32::from(u8::from(point.foreground));
            }
            let mean = |sum: [f32; 3]| sum.map(|x| x / count);
            (cube[0].0, list, Point { position: mean(sum), color: mean(color), foreground: 2.0 * foreground > count })
        })
        .collect();
    let better_beside = |cube: [i64; 3], list: usize| {
        (0..6).any(|side| {
            let mut beside = cube;
            beside[side / 2] += if side % 2 == 0 { 1 } else { -1 };
            merged.binary_search_by(|other| other.0.cmp(&beside)).is_ok_and(|at| merged[at].1 < list)
        })
    };
    merged
        .par_iter()
        .filter(|(cube, list, _)| *list == 0 || !better_beside(*cube, *list))
        .map(|(_, list, point)| (*list, *point))
        .collect()
}
