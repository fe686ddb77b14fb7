use super::*;

fn swept(base: &Method, extent: Extent) -> Vec<Point> {
    let allocations = [
        Allocation::Entropy,
        Allocation::Laplacian,
        Allocation::Random,
        Allocation::PixelAligned,
        Allocation::Merged,
    ];
    points(base, &allocations, extent, false, true)
}

#[test]
fn points_have_names_of_their_own_and_one_is_the_base() {
    for extent in [Extent::Quick, Extent::Full, Extent::Paper] {
        let all = swept(&Method::feed_forward(Config::default()), extent);
        let mut names: Vec<&str> = all.iter().map(|point| point.label.point.as_str()).collect();
        let plain = |c: char| c.is_ascii_alphanumeric() || "-=.".contains(c);
        assert!(names.iter().all(|name| name.chars().all(plain)), "{names:?}");
        assert_eq!(all.iter().filter(|point| point.label.base).count(), 1);
        names.sort_unstable();
        assert!(names.windows(2).all(|pair| pair[0] != pair[1]), "{names:?}");
    }
}

#[test]
fn every_point_but_those_of_other_budgets_differs_from_the_base_in_one_setting() {
    let base = Method::feed_forward(Config::default());
    for point in swept(&base, Extent::Full) {
        if matches!(point.label.axis, Axis::Budget | Axis::Allocation) {
            continue;
        }
        let json = |method: &Method| serde_json::to_value(method).unwrap();
        let (a, b) = (json(&base), json(&point.method));
        // One point with a refinement has no correction.
        let part = |key: &str| key == "correction" && point.label.point == "refine-60-uncorrected";
        let differs = |(key, value): &(&String, &serde_json::Value)| b[key.as_str()] != **value && !part(key);
        let changed = a.as_object().unwrap().iter().filter(differs);
        let changed =
            changed.count() + usize::from(point.cuts != Cuts::default()) + usize::from(point.shrink != 1);
        assert_eq!(changed, 1, "{}", point.label.point);
    }
}

#[test]
fn what_is_corrected_and_what_not() {
    let all = swept(&Method::feed_forward(Config::default()), Extent::Full);
    let uncorrected = all.iter().filter(|point| !corrects(&point.method.pass()));
    let names: Vec<&str> = uncorrected.map(|point| point.label.point.as_str()).collect();
    let alone = ["looks-1", "uncorrected", "refine-60-uncorrected", "given-depth"];
    let is_known = |name: &&str| {
        alone.contains(name) || ["merged-", "closed-form-"].iter().any(|kind| name.starts_with(kind))
    };
    assert!(names.iter().all(is_known), "{names:?}");
    assert!(alone[..3].iter().all(|name| names.contains(name)), "{names:?}");
    // There is nothing to leave out where nothing corrects.
    for config in [
        Config { head: Head::ClosedForm, ..Config::default() },
        Config { correction: Correction::Off, ..Config::default() },
        Config { looks: 1, ..Config::default() },
    ] {
        let all = swept(&Method::feed_forward(config), Extent::Full);
        assert!(all.iter().all(|point| point.label.point != "uncorrected"));
    }
    // Weights that are named are for the base's backbone, and for Gaussians with anchors.
    let named = Config { correction: Correction::Weights("w".into()), ..Config::default() };
    for point in swept(&Method::feed_forward(named), Extent::Full) {
        let Config { allocation, backbone, correction, .. } = &point.method.predict;
        let fits = *allocation != Allocation::Merged && *backbone != Backbone::GivenDepth;
        let off = point.label.point.ends_with("uncorrected") || !fits;
        assert_eq!(*correction == Correction::Off, off, "{}", point.label.point);
    }
}

#[test]
fn the_factor_on_smooth_pixels_is_swept_where_it_applies() {
    let weight = |config: Config| {
        let all = swept(&Method::feed_forward(config), Extent::Full);
        let point = all.into_iter().find(|point| point.label.point.starts_with("smooth-weight="))?;
        Some((point.label.point, point.method.predict.smooth_weight))
    };
    assert_eq!(weight(Config::default()), Some(("smooth-weight=1".to_owned(), 1.0)));
    let paper = Config { smooth_weight: 1.0, ..Config::default() };
    assert_eq!(weight(paper), Some(("smooth-weight=0.1".to_owned(), 0.1)));
    assert_eq!(weight(Config { allocation: Allocation::Laplacian, ..Config::default() }), None);
}

#[test]
fn a_budget_of_ones_own_joins_the_others_and_what_is_there_is_not_added_twice() {
    let config = Config { budget: Budget::Gaussians(1_500), neighbours: 5, ..Config::default() };
    let base = Method::refined(config, refine::Config::default());
    let all = swept(&base, Extent::Quick);
    let named = |name: &str| all.iter().find(|point| point.label.point == name);
    assert!(named("entropy-1500").unwrap().label.base && named("random-1500").is_some());
    assert!(named("K=5").is_none() && named("K=20").is_some() && named("refine-10").is_none());
    assert_eq!(named("uncorrected").unwrap().method.predict.correction, Correction::Off);
    let learned = points(&base, &[], Extent::Quick, true, false);
    assert!(learned.iter().any(|point| point.method.predict.head == Head::ClosedForm));
    assert!(learned.iter().all(|point| point.label.axis != Axis::Backbone));
    // The other head with weights is on the axis of heads, unless it is the base's.
    let attentions = |config: Config| {
        let all = points(&Method::feed_forward(config), &[], Extent::Quick, true, false);
        all.iter().filter(|point| point.label.point.starts_with("attention-")).count()
    };
    assert!(attentions(Config::default()) > 1);
    let curve = |point: &str| learned.iter().find(|p| p.label.point == point).unwrap().label.curve();
    assert_eq!(curve("entropy-10k").as_deref(), Some("entropy"));
    assert_eq!(curve("closed-form-10k").as_deref(), Some("entropy, closed form"));
    assert_eq!(curve("attention-10k").as_deref(), Some("entropy, attention"));
    assert_eq!(curve("closed-form-pixel-aligned"), None);
    assert_eq!(attentions(Config { head: Head::Attention, ..Config::default() }), 0);
    // Depth is that of the base, and the other.
    let depths = |depth: SweepDepth| {
        let backbone = Backbone::PlaneSweep { planes: 128, depth };
        let base = Method::feed_forward(Config { backbone, ..Config::default() });
        let of_depth = |point: &Point| point.label.axis == Axis::Depth;
        swept(&base, Extent::Quick).into_iter().filter(of_depth).map(|p| p.label.point).collect::<Vec<_>>()
    };
    assert_eq!(depths(SweepDepth::Stereo), ["learned-depth"]);
    assert_eq!(depths(SweepDepth::Learned), ["stereo-depth"]);
    let fusions = |fuse: bool| {
        let base = Method::feed_forward(Config { fuse, ..Config::default() });
        let of_fusion = |point: &Point| point.label.axis == Axis::Fusion;
        let found: Vec<Point> = swept(&base, Extent::Quick).into_iter().filter(of_fusion).collect();
        assert!(found.iter().all(|point| point.method.predict.fuse != fuse));
        found.into_iter().map(|point| point.label.point).collect::<Vec<_>>()
    };
    assert_eq!((fusions(false), fusions(true)), (vec!["fuse".to_owned()], vec!["no-fuse".to_owned()]));
    // DepthSplat's own Gaussians are one more point where they can be had.
    let of_network = |point: &&Point| point.method.predict.head == Head::DepthSplat;
    assert!(!all.iter().any(|point| of_network(&point)));
    let backbone = Backbone::DepthSplat("weights".into());
    let base = Method::feed_forward(Config { backbone, ..Config::default() });
    let network_points: Vec<Point> =
        swept(&base, Extent::Quick).into_iter().filter(|p| of_network(&p)).collect();
    assert!(network_points.len() == 1 && network_points[0].label.point == "depthsplat-pixel-aligned");
}

#[test]
fn what_no_seed_changes_is_measured_with_one() {
    for point in swept(&Method::feed_forward(Config::default()), Extent::Full) {
        let takes_all = ["pixel-aligned", "merged"].contains(&point.label.allocation.as_str());
        assert_eq!(point.label.seeds(&[4, 5]).len(), if takes_all { 1 } else { 2 }, "{:?}", point.label);
        assert_eq!(point.label.count.is_none(), point.label.allocation == "pixel-aligned");
    }
}

#[test]
fn the_usual_cut_offs_are_the_renderers() {
    assert_eq!(Cuts::default(), Cuts { alpha_min: 1.0 / 255.0, transmittance_min: 1e-4 });
}
