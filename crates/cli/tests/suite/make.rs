//! `tcgs make`: one command from videos to a scene and a page, and how it goes on.

use std::fs;

use crate::support::server::has_page;
use crate::support::videos::*;
use crate::support::*;
use tempfile::tempdir;

#[test]
fn videos_become_a_scene_and_a_page() {
    if !has_ffmpeg() {
        return;
    }
    let folder = tempdir().unwrap();
    let source = videos_of(&folder, 4, [64, 48]);
    // The sound of one camera, with its pauses.
    let (silent, loud) = (source.join("cam2.mp4"), source.join("cam2.mkv"));
    let tone = "sine=frequency=440:duration=2,volume='if(lt(mod(t,0.1),0.05),1,0.01)':eval=frame";
    let with_sound = ["-i", text(&silent), "-f", "lavfi", "-i", tone, "-c:v", "copy", "-c:a", "libopus", "-shortest"];
    ffmpeg(&[&with_sound[..], &[text(&loud)]].concat());
    fs::remove_file(&silent).unwrap();
    let (scene, place, result) =
        (folder.path().join("film.tcgs"), folder.path().join("film"), folder.path().join("result.json"));
    let make = ["make", text(&source), "--out", text(&scene), "--time", "2s", "--hold-out", "cam3", "--backend", "cpu"];

    let said = succeed(&[&make[..], &["--json", text(&result)]].concat());
    for expected in
        ["1/4  tcgs prepare", "2/4  tcgs train", "3/4  tcgs compress", "sound: that of cam2", "next: tcgs view"]
    {
        assert!(said.contains(expected), "{expected:?} in {said}");
    }
    assert_eq!(said.matches("next: ").count(), 1, "{said}");
    for file in ["capture/check.html", "run/config.toml", "sound.ogg", "make.json", "report.html"] {
        assert!(place.join(file).exists(), "{file}");
    }
    assert!(!place.join("speed").exists());
    let result = json(&result);
    assert_keys(&result, &["scene", "report", "bytes", "psnr", "held_out", "seconds"]);
    assert_eq!(
        (result["bytes"].as_u64(), result["held_out"].as_bool()),
        (Some(fs::metadata(&scene).unwrap().len()), Some(true))
    );
    assert!(result["psnr"].as_f64().unwrap() > 15.0, "{result}");
    assert!(succeed(&["info", text(&scene)]).contains("tcgs.sound"));
    let page = fs::read_to_string(place.join("report.html")).unwrap();
    for expected in
        ["Camera cam3, frame 0: photograph, and render", "Between the cameras", "tcgs compress", "data:image/png"]
    {
        assert!(page.contains(expected), "{expected}");
    }
    assert!(!page.contains("Not measured"));
    assert_eq!(page.contains("srcdoc=") && page.contains("data-scene="), has_page());

    // Finished steps are not repeated.
    let before = fs::read(&scene).unwrap();
    let said = succeed(&make);
    assert!(
        ["prepare: done before", "train: done before", "compress: done before"].iter().all(|s| said.contains(s)),
        "{said}"
    );
    assert_eq!(fs::read(&scene).unwrap(), before);
    let mut other = make;
    other[5] = "3s";
    let message = fail(2, &other);
    assert!(message.contains("time_seconds was 2.0, found 3.0, expected the same command"), "{message}");
}

#[test]
fn nothing_of_others_is_replaced() {
    let folder = tempdir().unwrap();
    let (source, scene, place) =
        (folder.path().join("videos"), folder.path().join("film.tcgs"), folder.path().join("film"));
    fs::create_dir(&source).unwrap();
    let make = ["make", text(&source), "--out", text(&scene)];
    let message = fail(2, &make);
    assert!(message.contains("no videos here"), "{message}");
    let message = fail(2, &["make", text(&source), "--out", text(&place)]);
    assert!(message.contains("film: expected NAME.tcgs for the scene"), "{message}");

    assert!(!place.exists());
    fs::write(source.join("cam0.mp4"), "not read yet").unwrap();
    fs::create_dir(&place).unwrap();
    fs::write(place.join("run"), "mine").unwrap();
    let message = fail(2, &make);
    assert!(message.contains("was not made by tcgs make"), "{message}");
    fs::remove_dir_all(&place).unwrap();
    fs::write(&scene, "mine").unwrap();
    let message = fail(2, &make);
    assert!(message.contains("film.tcgs: exists"), "{message}");
    assert_eq!(fs::read_to_string(&scene).unwrap(), "mine");
}

#[test]
fn a_capture_with_points_is_trained_at_once() {
    let folder = tempdir().unwrap();
    let scene = folder.path().join("scene.tcgs");
    let make = ["make", text(capture()), "--out", text(&scene), "--time", "1s", "--backend", "cpu"];
    let said = succeed(&make);
    assert!(said.contains("is a capture with points") && said.contains("sound: none"), "{said}");
    let place = folder.path().join("scene");
    assert!(scene.exists() && place.join("report.html").exists() && !place.join("capture").exists());
}
