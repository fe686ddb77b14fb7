use crate::{WALK, config, is_keyframe, push_all, stereo};
use glam::DVec3;
use gs_scene::{Camera, DepthMap, Image, View};
use mapper::{Config, Frame, Mapper, Outcome, Refusal, Waiting};

fn begun() -> Mapper {
    let mut mapper = Mapper::new(config()).unwrap();
    push_all(&mut mapper, &WALK[..3]);
    mapper
}

/// The same frame seen from elsewhere.
fn moved(view: &View, by: DVec3) -> View {
    let camera = view.camera();
    let camera = Camera::from_camera_to_world(
        *camera.intrinsics(),
        camera.rotation().transpose(),
        camera.position() + by,
    )
    .unwrap();
    View::new(view.name(), view.image().clone(), camera, view.depth().cloned()).unwrap()
}

fn refusal(mapper: &mut Mapper, frame: &Frame) -> Refusal {
    let before = mapper.map().clone();
    let Outcome::Refused(refusal) = mapper.push(frame).unwrap().outcome else { panic!("not refused") };
    assert_eq!(*mapper.map(), before);
    assert!(!refusal.to_string().is_empty());
    refusal
}

#[test]
fn a_jump_is_refused_once_and_believed_when_it_lasts() {
    let mut mapper = begun();
    let far = moved(&WALK[3], DVec3::new(1e4, 0.0, 0.0));
    assert!(matches!(refusal(&mut mapper, &far.clone().into()), Refusal::Jump { .. }));
    // Back where it was: one wrong pose costs one frame.
    assert!(!matches!(mapper.push(&WALK[4].clone().into()).unwrap().outcome, Outcome::Refused(_)));
    assert!(matches!(refusal(&mut mapper, &far.clone().into()), Refusal::Jump { .. }));
    let there = moved(&far, DVec3::new(0.02, 0.0, 0.0));
    assert!(is_keyframe(&mapper.push(&there.into()).unwrap()), "the camera was carried there");
    assert!(mapper.map().geometry().iter().all(|value| value.is_finite()));
}

#[test]
fn pictures_that_show_nothing_are_refused() {
    let mut mapper = begun();
    let view = &WALK[3];
    let (width, height) = (view.image().width(), view.image().height());
    let with = |image: Image, depth: Option<DepthMap>| -> Frame {
        View::new("hostile", image, *view.camera(), depth).unwrap().into()
    };
    let black = Image::filled(width, height, [0.0; 3]).unwrap();
    assert_eq!(refusal(&mut mapper, &with(black, view.depth().cloned())), Refusal::NoContrast);
    let mut broken = view.image().clone();
    broken.data_mut()[3 * (width + 2) + 1] = f32::NAN;
    let frame = with(broken, view.depth().cloned());
    assert_eq!(refusal(&mut mapper, &frame), Refusal::PixelNotFinite { x: 2, y: 1 });
    assert_eq!(refusal(&mut mapper, &with(view.image().clone(), None)), Refusal::NoDepth);
    let blind = DepthMap::new(width, height, vec![f32::NAN; width * height]).unwrap();
    assert_eq!(refusal(&mut mapper, &with(view.image().clone(), Some(blind))), Refusal::NoDepth);
}

#[test]
fn time_does_not_run_backwards() {
    let mut mapper = Mapper::new(config()).unwrap();
    let mut at = |time| mapper.push(&Frame { view: WALK[0].clone(), time: Some(time) }).unwrap().outcome;
    assert!(matches!(at(5.0), Outcome::Keyframe(_)));
    assert_eq!(at(4.0), Outcome::Refused(Refusal::TimeBackwards { time: 4.0, latest: 5.0 }));
    assert_eq!(at(f64::NAN), Outcome::Refused(Refusal::TimeNotFinite));
    assert!(matches!(at(5.0), Outcome::Seen(_)), "two frames may have one time");
}

#[test]
fn one_frame_again_and_again_is_one_keyframe() {
    let mut mapper = Mapper::new(config()).unwrap();
    let updates = push_all(&mut mapper, &vec![WALK[0].clone(); 200]);
    assert_eq!(updates.iter().filter(|update| is_keyframe(update)).count(), 1);
    let mut mapper = Mapper::new(stereo()).unwrap();
    for update in push_all(&mut mapper, &vec![WALK[0].clone(); 200]) {
        assert_eq!(update.outcome, Outcome::Waiting(Waiting::FirstKeyframes));
    }
    assert_eq!(mapper.map().len(), 0);
}

#[test]
fn a_thousand_units_away_the_map_is_the_same_room() {
    let mut near = Mapper::new(config()).unwrap();
    let mut far = Mapper::new(config()).unwrap();
    let offset = DVec3::new(1000.0, -500.0, 20.0);
    push_all(&mut near, &WALK[..6]);
    let there: Vec<View> = WALK[..6].iter().map(|view| moved(view, offset)).collect();
    push_all(&mut far, &there);
    let (a, b) = (near.map().len() as f64, far.map().len() as f64);
    assert!((a / b - 1.0).abs() < 0.02, "{a} {b}");
}

#[test]
fn a_picture_of_one_pixel_and_frames_of_other_sizes_are_taken_as_they_are() {
    let mut mapper = begun();
    let view = &WALK[3];
    let small = view.camera().with_intrinsics(view.camera().intrinsics().resized(30, 20)).unwrap();
    let picture: Vec<f32> = (0..30 * 20 * 3).map(|i| (i % 7) as f32 / 7.0).collect();
    let depth = DepthMap::new(30, 20, vec![2.0; 600]).unwrap();
    let frame = View::new("small", Image::new(30, 20, picture).unwrap(), small, Some(depth)).unwrap();
    mapper.push(&frame.into()).unwrap();
    let one = view.camera().with_intrinsics(view.camera().intrinsics().resized(1, 1)).unwrap();
    let depth = DepthMap::new(1, 1, vec![2.0]).unwrap();
    let frame = View::new("one", Image::filled(1, 1, [0.5; 3]).unwrap(), one, Some(depth)).unwrap();
    assert_eq!(refusal(&mut mapper, &frame.into()), Refusal::NoContrast);
    let mut stereo = Mapper::new(Config { window: 2, kept: 2, ..stereo() }).unwrap();
    push_all(&mut stereo, &WALK[..8]);
}
