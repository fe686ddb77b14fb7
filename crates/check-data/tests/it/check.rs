//! Checks of simulated photographs: what is right passes, and what was broken is named.

use check_data::{CheckReport, CheckSettings, CheckStage, RangeSource, Severity, check_data, layout_html};
use glam::DVec3;
use gs_scene::{Camera, Image, Lens, LensModel, View};
use scene_sim::{Traced, demo_scene, lens, render_view};
use serde_json::{Value, json};
use std::path::{Path, PathBuf};
use std::sync::OnceLock;
use tempfile::TempDir;
use view_data::{DatasetWriter, Layout, PictureFormat, open_nerfstudio};

const WIDTH: usize = 240;
const HEIGHT: usize = 180;
const COUNT: usize = 10;
/// Less is matched than by default: tests are many.
const SETTINGS: CheckSettings = CheckSettings { pairs: 24, corners: 450, thumbnails: 12, seed: 0 };

/// Views of the demonstration's scene along a path that repeats nowhere, so that no two readings of its poses
/// agree; rendered once.
fn views() -> &'static [View] {
    static VIEWS: OnceLock<Vec<View>> = OnceLock::new();
    VIEWS.get_or_init(|| {
        let scene = Traced::new(&demo_scene()).unwrap();
        let camera = |i: usize| {
            let t = i as f64;
            let angle = (-132.0 + 3.4 * t + 0.12 * t * t).to_radians();
            let radius = 4.3 + 0.3 * (1.9 * t).sin();
            let height = 1.7 + 0.25 * (1.3 * t).sin();
            let position = DVec3::new(0.4 + radius * angle.cos(), 0.9 + radius * angle.sin(), height);
            let target = DVec3::new(0.4 + 0.1 * (2.3 * t).sin(), 0.9, 0.95 + 0.1 * (1.1 * t).cos());
            let up = DVec3::new(0.1 * (0.9 * t).sin(), 0.0, 1.0);
            Camera::looking_at(lens(WIDTH, HEIGHT, 62.0), position, target, up).unwrap()
        };
        (0..COUNT).map(|i| render_view(&scene, &camera(i), 4, format!("view{i:02}"), 0).unwrap()).collect()
    })
}

/// A set of those views on disk, to be broken.
struct Set {
    _folder: TempDir,
    root: PathBuf,
}

impl Set {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let root = folder.path().join("courtyard");
        let mut writer = DatasetWriter::create(&root, Layout::Nerfstudio, PictureFormat::Png).unwrap();
        for view in views() {
            let lens = Lens { intrinsics: *view.camera().intrinsics(), model: LensModel::PINHOLE };
            writer.add(view, &lens).unwrap();
        }
        writer.finish().unwrap();
        let set = Self { _folder: folder, root };
        set.write_depth(1000.0, 0.001, |_, z, _| z);
        set
    }

    /// Depth in PNG files of `counts` per metre, which are said to hold `unit` metres; `depth` makes it of
    /// the frame, the z-depth and the length of the ray of unit z.
    fn write_depth(&self, counts: f64, unit: f64, depth: impl Fn(usize, f64, f64) -> f64) {
        self.edit(|value| {
            value["depth_unit_scale_factor"] = json!(unit);
            for (i, frame) in value["frames"].as_array_mut().unwrap().iter_mut().enumerate() {
                frame["depth_file_path"] = json!(format!("depth16/{i}.png"));
            }
        });
        std::fs::create_dir_all(self.root.join("depth16")).unwrap();
        for (i, view) in views().iter().enumerate() {
            let (data, lens) = (view.depth().unwrap().data(), *view.camera().intrinsics());
            let at = |x: u32, y: u32| {
                let ray = lens.ray(glam::DVec2::new(f64::from(x) + 0.5, f64::from(y) + 0.5)).length();
                let z = f64::from(data[y as usize * WIDTH + x as usize]);
                image::Luma([(counts * depth(i, z, ray)).round() as u16])
            };
            let picture = image::ImageBuffer::from_fn(WIDTH as u32, HEIGHT as u32, at);
            picture.save(self.root.join(format!("depth16/{i}.png"))).unwrap();
        }
    }

    fn picture(&self, i: usize) -> PathBuf {
        self.root.join(format!("images/view{i:02}.png"))
    }

    /// Changes `transforms.json`.
    fn edit(&self, change: impl FnOnce(&mut Value)) {
        let path = self.root.join("transforms.json");
        let mut value: Value = serde_json::from_slice(&std::fs::read(&path).unwrap()).unwrap();
        change(&mut value);
        std::fs::write(path, value.to_string()).unwrap();
    }

    /// Replaces every camera-to-world matrix by what `change` makes of it (OpenGL axes, as in the file).
    fn edit_poses(&self, change: impl Fn(glam::DMat4) -> glam::DMat4) {
        self.edit(|value| {
            for frame in value["frames"].as_array_mut().unwrap() {
                let rows = frame["transform_matrix"].as_array().unwrap().clone();
                let at = |r: usize, c: usize| rows[r][c].as_f64().unwrap();
                let matrix = glam::DMat4::from_cols_array_2d(&std::array::from_fn(|c| {
                    std::array::from_fn(|r| at(r, c))
                }));
                let columns = change(matrix).to_cols_array_2d();
                let row = |r: usize| -> Vec<f64> { (0..4).map(|c| columns[c][r]).collect() };
                frame["transform_matrix"] = json!([row(0), row(1), row(2), row(3)]);
            }
        });
    }

    fn check(&self) -> CheckReport {
        check_data(&open_nerfstudio(&self.root).unwrap(), &SETTINGS, |_| {}).unwrap()
    }
}

fn texts<'a>(report: &'a CheckReport, rule: &str) -> Vec<&'a str> {
    report.findings.iter().filter(|f| f.rule == rule).map(|f| f.text.as_str()).collect()
}

fn places<'a>(report: &'a CheckReport, rule: &str) -> Vec<&'a str> {
    report.findings.iter().filter(|f| f.rule == rule).map(|f| f.place.as_str()).collect()
}

/// The one finding about the convention of the poses.
fn convention(report: &CheckReport) -> (Severity, &str) {
    let found: Vec<_> = report.findings.iter().filter(|f| f.rule == "pose-convention").collect();
    assert_eq!(found.len(), 1, "{:#?}", report.findings);
    (found[0].severity, found[0].text.as_str())
}

#[test]
fn a_good_set_passes() {
    let report = Set::new().check();
    assert!(report.worst() <= Severity::Note, "{:#?}", report.findings);
    let (severity, text) = convention(&report);
    assert!(severity == Severity::Ok && text.contains("right as read"), "{text}");
    let as_read = report.poses.readings[0];
    assert!(as_read.median.unwrap() < 0.4 && as_read.in_front.unwrap() > 0.98, "{as_read:?}");
    let depth = report.depth.as_ref().unwrap();
    assert!((depth.ratio.unwrap() - 1.0).abs() < 0.01 && depth.consistent.unwrap() > 0.8, "{depth:?}");
    assert_eq!((report.pictures.decoded, report.frames), (COUNT, COUNT));
    assert_eq!(report.overlap.as_ref().unwrap().components, [COUNT]);
    // Against the views themselves.
    let mut depths: Vec<f32> = views().iter().flat_map(|v| v.depth().unwrap().data().to_vec()).collect();
    depths.retain(|depth| *depth > 0.0);
    depths.sort_by(f32::total_cmp);
    let median = f64::from(depths[depths.len() / 2]);
    let range = report.range.unwrap();
    assert!((range.percentiles[2] / median - 1.0).abs() < 0.05, "{range:?} {median}");
    assert!(range.near_far[0] < f64::from(depths[depths.len() / 50]));
}

#[test]
fn the_same_report_on_one_thread_and_on_many() {
    let set = Set::new();
    let dataset = open_nerfstudio(&set.root).unwrap();
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| check_data(&dataset, &SETTINGS, |_| {}).unwrap())
    };
    let (one, many) = (on(1), on(4));
    assert_eq!(serde_json::to_string(&one).unwrap(), serde_json::to_string(&many).unwrap());
    assert_eq!(one, many);
}

#[test]
fn each_misreading_of_the_poses_is_named() {
    let flip = glam::DMat4::from_diagonal(glam::DVec4::new(1.0, -1.0, -1.0, 1.0));
    let y = glam::DMat4::from_diagonal(glam::DVec4::new(1.0, -1.0, 1.0, 1.0));
    type Mistake = Box<dyn Fn(glam::DMat4) -> glam::DMat4>;
    let cases: [(&str, Mistake); 4] = [
        ("y and z of the camera axes are flipped", Box::new(move |m| m * flip)),
        ("the matrices are the inverse", Box::new(|m| m.inverse())),
        ("the matrices are the inverse", Box::new(move |m| (m * flip).inverse())),
        ("the y axis is flipped alone", Box::new(move |m| y * m * y)),
    ];
    for (meaning, mistake) in cases {
        let set = Set::new();
        set.edit_poses(mistake);
        let report = set.check();
        let (severity, text) = convention(&report);
        assert!(severity == Severity::Error && text.contains(meaning), "{meaning}: {text}");
        assert!(report.poses.readings[0].median.unwrap() > 2.0, "{:?}", report.poses.readings[0]);
    }
}

#[test]
fn intrinsics_for_another_size_are_named() {
    let set = Set::new();
    set.edit(|value| {
        for key in ["fl_x", "fl_y", "cx", "cy"] {
            let holders = if value.get(key).is_some() {
                vec![&mut *value]
            } else {
                value["frames"].as_array_mut().unwrap().iter_mut().collect()
            };
            for holder in holders {
                holder[key] = json!(holder[key].as_f64().unwrap() * 0.5);
            }
        }
    });
    let report = set.check();
    let (severity, text) = convention(&report);
    assert!(severity == Severity::Error && text.contains("half the size"), "{text}");
    assert_eq!(texts(&report, "principal-point").len(), 1);
}

#[test]
fn exchanged_missing_truncated_and_equal_files_are_named() {
    let set = Set::new();
    let aside = set.root.join("aside.png");
    std::fs::rename(set.picture(2), &aside).unwrap();
    std::fs::rename(set.picture(7), set.picture(2)).unwrap();
    std::fs::rename(&aside, set.picture(7)).unwrap();
    let report = set.check();
    let found = texts(&report, "frames-exchanged");
    assert!(found.len() == 1 && found[0].contains("view02 and view07"), "{:#?}", report.findings);

    let set = Set::new();
    std::fs::remove_file(set.picture(0)).unwrap();
    let whole = std::fs::read(set.picture(3)).unwrap();
    std::fs::write(set.picture(3), &whole[..whole.len() / 2]).unwrap();
    std::fs::copy(set.picture(5), set.picture(8)).unwrap();
    let report = set.check();
    let only = |rule: &str, name: &str| {
        let found = places(&report, rule);
        assert!(found.len() == 1 && found[0].contains(name), "{rule}: {:#?}", report.findings);
    };
    only("picture-missing", "view00");
    only("picture-broken", "view03");
    only("picture-duplicate", "view05");
    assert_eq!((report.pictures.decoded, report.pictures.missing, report.pictures.broken), (COUNT - 2, 1, 1));
    // The copy's content does not fit its pose; the original's does.
    assert!(
        places(&report, "frame-pose").iter().all(|place| place.contains("view08")),
        "{:#?}",
        report.findings
    );
    assert_eq!(report.worst(), Severity::Error);
}

#[test]
fn wrong_depth_is_named() {
    let set = Set::new();
    // Counts of 1/1000 m that are read as 1/5000.
    set.write_depth(1000.0, 0.0002, |_, z, _| z);
    let report = set.check();
    let found = texts(&report, "depth-scale");
    assert!(found.len() == 1 && found[0].contains("0.200 times") && found[0].contains("1/1000"), "{found:?}");
    // Depth in another unit than the poses does not make the range.
    assert_eq!(report.range.unwrap().source, RangeSource::Matches);
    set.write_depth(1000.0, 0.001, |_, z, ray| z * ray);
    assert_eq!(texts(&set.check(), "depth-along-ray").len(), 1);
    set.write_depth(1000.0, 0.001, |i, z, _| if i == 4 { 0.0 } else { z });
    std::fs::write(set.root.join("depth16/6.png"), b"no picture").unwrap();
    let report = set.check();
    assert!(texts(&report, "depth-empty")[0].contains("view04"));
    assert!(places(&report, "depth-broken")[0].contains("view06"));
}

/// A set of the given pictures with the given poses.
fn tiny(pictures: &[Image], poses: &[Value]) -> (TempDir, CheckReport) {
    let folder = tempfile::tempdir().unwrap();
    std::fs::create_dir(folder.path().join("images")).unwrap();
    let path = |i: usize| format!("images/{i}.png");
    let frame = |(i, pose): (usize, &Value)| json!({"file_path": path(i), "transform_matrix": pose});
    let frames: Vec<Value> = poses.iter().enumerate().map(frame).collect();
    let (w, h) = (pictures[0].width(), pictures[0].height());
    let file = json!({"w": w, "h": h, "fl_x": 200.0, "frames": frames});
    std::fs::write(folder.path().join("transforms.json"), file.to_string()).unwrap();
    for (i, picture) in pictures.iter().enumerate() {
        let bytes = picture.to_rgb8();
        let buffer = image::RgbImage::from_raw(w as u32, h as u32, bytes).unwrap();
        buffer.save(folder.path().join(path(i))).unwrap();
    }
    let report = check_data(&open_nerfstudio(folder.path()).unwrap(), &SETTINGS, |_| {}).unwrap();
    (folder, report)
}

#[test]
fn hostile_sets_give_findings_and_pages() {
    let photograph = views()[0].image().clone();
    let black = Image::filled(WIDTH, HEIGHT, [0.0; 3]).unwrap();
    let dot = Image::filled(1, 1, [0.5; 3]).unwrap();
    // At (x, 0, 0), with OpenGL axes that look along the world's +z with y down.
    let pose = |x: f64| {
        json!([[1.0, 0.0, 0.0, x], [0.0, -1.0, 0.0, 0.0], [0.0, 0.0, -1.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
    };
    let cases: [(&str, Vec<Image>, Vec<Value>); 5] = [
        ("one-frame", vec![photograph.clone()], vec![pose(0.0)]),
        ("picture-duplicate", vec![photograph.clone(), photograph.clone()], vec![pose(0.0), pose(0.0)]),
        ("picture-empty", vec![black; 3], vec![pose(0.0), pose(1.0), pose(2.0)]),
        ("one-place", vec![photograph; 3], vec![pose(7.0); 3]),
        ("too-few-matches", vec![dot; 2], vec![pose(0.0), pose(5e5)]),
    ];
    for (rule, pictures, poses) in cases {
        let (_folder, mut report) = tiny(&pictures, &poses);
        // The letters of an encoded picture may spell anything.
        report.thumbnails.clear();
        assert!(report.findings.iter().any(|finding| finding.rule == rule), "{rule}: {:#?}", report.findings);
        assert!(report.worst() >= Severity::Warning);
        let page = layout_html(&report);
        assert!(!page.contains("NaN") && !page.contains("inf\"") && page.ends_with("</html>\n"), "{rule}");
        let json = serde_json::to_string(&report).unwrap();
        assert!(json.contains("\"findings\"") && json.contains(rule), "{json}");
    }
}

#[test]
fn progress_reaches_its_end_in_every_stage() {
    let set = Set::new();
    let steps = std::sync::Mutex::new(Vec::new());
    let dataset = open_nerfstudio(&set.root).unwrap();
    check_data(&dataset, &CheckSettings { pairs: 6, ..SETTINGS }, |step| {
        steps.lock().unwrap().push(step);
    })
    .unwrap();
    let steps = steps.into_inner().unwrap();
    for (stage, of) in [(CheckStage::Headers, COUNT), (CheckStage::Pictures, COUNT), (CheckStage::Pairs, 6)] {
        let of_stage: Vec<_> = steps.iter().filter(|step| step.stage == stage).collect();
        assert!(of_stage.len() == of && of_stage.iter().all(|step| step.of == of), "{of_stage:?}");
        assert_eq!(of_stage.iter().map(|step| step.done).max(), Some(of));
    }
}

#[test]
fn the_page_holds_everything_and_names_cannot_break_it() {
    let mut report = Set::new().check();
    report.name = "<script>\"x\" & y".to_owned();
    report.cameras[0].name = "<b>first</b>".to_owned();
    report.findings[0].text = "<i>".to_owned();
    let page = layout_html(&report);
    for tag in ["<script>", "<b>first", "<i>", "http:", "https:", "src=\"/"] {
        assert!(!page.contains(tag), "{tag}");
    }
    assert_eq!(page.matches("<svg").count(), 3);
    assert_eq!(page.matches("data:image/jpeg;base64,").count(), report.thumbnails.len());
    assert_eq!(report.thumbnails.len(), COUNT);
    assert!(report.findings.iter().all(|finding| page.contains(finding.rule)));
    let _: &Path = Path::new(&report.file);
}
