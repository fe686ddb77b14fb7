//! The page: its files, with data in their places.

use crate::Result;
use crate::pack::{Header, Precision, packed};
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use gs_raster::{
    ELLIPSOID_OPACITY_MIN, ELLIPSOID_SIGMA, NEAR_SAMPLE, NEAR_SHARE, RenderSettings, SLOPE_MARGIN,
};
use gs_scene::{Camera, Gaussians, Intrinsics};
use gs_shaders::{Drawing, Features, Table, View};
use html_escape::encode_double_quoted_attribute;
use serde::Serialize;
use std::collections::BTreeMap;
use std::fmt::Write;

const HTML: &str = include_str!("../page/page.html");
const STYLE: &str = include_str!("../page/page.css");
const PRESENT: &str = include_str!("../page/present.wgsl");
/// In the order in which one script uses the others.
const SCRIPTS: [&str; 5] = [
    include_str!("../page/scene.js"),
    include_str!("../page/camera.js"),
    include_str!("../page/gpu.js"),
    include_str!("../page/controls.js"),
    include_str!("../page/main.js"),
];

/// Highest degree of spherical harmonics; scenes that are dropped onto a page may have it.
const DEGREE_MAX: usize = 3;

/// A camera to look from.
#[derive(Debug, Clone)]
pub struct Shot {
    /// Name in the list.
    pub name: String,
    /// Camera; its lens gives the field of view.
    pub camera: Camera,
    /// Photograph of that camera as JPEG, of any size.
    pub photograph: Option<Vec<u8>>,
}

/// A picture for browsers that cannot draw the scene.
#[derive(Debug, Clone)]
pub struct Still {
    /// Caption.
    pub name: String,
    /// JPEG.
    pub picture: Vec<u8>,
}

/// Where Gaussians begin to be drawn.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Near {
    /// At a share of the scene's distance, as [`gs_raster::near_plane`].
    #[default]
    OfScene,
    /// At the settings' near plane.
    OfSettings,
}

/// A scene as a page.
#[derive(Debug, Clone)]
pub struct Page<'a> {
    /// Title.
    pub title: &'a str,
    /// Scene.
    pub gaussians: &'a Gaussians,
    /// Cameras to look from. Without any the page makes an overview.
    pub shots: &'a [Shot],
    /// Place in `shots` where the page starts.
    pub start: usize,
    /// Pictures for browsers without WebGPU.
    pub stills: &'a [Still],
    /// How the scene is drawn; style and depth are chosen on the page.
    pub settings: RenderSettings,
    /// Where Gaussians begin to be drawn.
    pub near: Near,
    /// Bits that the page keeps.
    pub precision: Precision,
}

#[derive(Serialize)]
struct Data<'a> {
    title: &'a str,
    table: Table,
    present: &'static str,
    degrees: Vec<usize>,
    /// What the uniform has of the settings, by view.
    frames: BTreeMap<&'static str, Frame>,
    near: NearRule,
    slope_margin: f64,
    shots: Vec<ShotData<'a>>,
    start: usize,
    scene: Header,
}

#[derive(Serialize, Clone, Copy)]
struct Frame {
    background: [f32; 3],
    far: f32,
    eps2d: f32,
    alpha_max: f32,
    alpha_min: f32,
    transmittance_min: f32,
    compensation_min: f32,
    ellipsoid_sigma: f32,
}

#[derive(Serialize)]
struct NearRule {
    fixed: Option<f32>,
    share: f64,
    sample: usize,
    fallback: f32,
    least: f32,
    far: f32,
}

#[derive(Serialize)]
struct ShotData<'a> {
    name: &'a str,
    camera: CameraData,
    #[serde(skip_serializing_if = "Option::is_none")]
    photograph: Option<String>,
}

/// A camera as the page has it: the rotation row by row.
#[derive(Serialize)]
struct CameraData {
    rotation: [f64; 9],
    translation: [f64; 3],
    intrinsics: Intrinsics,
}

impl CameraData {
    fn new(camera: &Camera) -> Self {
        Self {
            rotation: camera.rotation().transpose().to_cols_array(),
            translation: camera.translation().to_array(),
            intrinsics: *camera.intrinsics(),
        }
    }
}

impl Page<'_> {
    /// The page with the scene in it: one file that needs no network.
    ///
    /// # Errors
    /// If a setting is not finite.
    pub fn html(&self) -> Result<String> {
        let scene = STANDARD.encode(packed(self.gaussians, self.precision));
        self.fill("", &scene)
    }

    /// The page, and the scene that it fetches from `address`.
    ///
    /// # Errors
    /// As [`Page::html`].
    pub fn html_beside(&self, address: &str) -> Result<(String, Vec<u8>)> {
        let source = format!(" data-source=\"{}\"", encode_double_quoted_attribute(address));
        Ok((self.fill(&source, "")?, packed(self.gaussians, self.precision)))
    }

    fn fill(&self, source: &str, scene: &str) -> Result<String> {
        let mut stills = String::new();
        for Still { name, picture } in self.stills {
            let (name, picture) = (encode_double_quoted_attribute(name), data_url(picture));
            let _ = write!(
                stills,
                "<figure><img src=\"{picture}\" alt=\"{name}\"><figcaption>{name}</figcaption></figure>"
            );
        }
        // In JSON a < stands only in texts, where it may be written as an escape; no text can end the script.
        let data = serde_json::to_string(&self.data())?.replace('<', "\\u003c");
        let title = encode_double_quoted_attribute(self.title);
        let script = SCRIPTS.join("\n");
        let values = [
            ("title", title.as_ref()),
            ("style", STYLE),
            ("stills", &stills),
            ("data", &data),
            ("source", source),
            ("scene", scene),
            ("script", &script),
        ];
        // One walk over the template: what is put in is not looked at again.
        let mut page =
            String::with_capacity(HTML.len() + data.len() + scene.len() + stills.len() + script.len());
        let mut rest = HTML;
        while let Some((before, after)) = rest.split_once("{{") {
            let (name, after) = after.split_once("}}").expect("the template closes its places");
            let value =
                values.iter().find(|(known, _)| *known == name).expect("the template names known places").1;
            page.push_str(before);
            page.push_str(value);
            rest = after;
        }
        page.push_str(rest);
        Ok(page)
    }

    fn data(&self) -> Data<'_> {
        let degree = self.gaussians.sh_degree();
        let degrees: Vec<usize> = [degree, DEGREE_MAX][..1 + usize::from(degree < DEGREE_MAX)].to_vec();
        let mut views = Vec::new();
        for &degree in &degrees {
            for (name, depth, drawing) in [
                ("colour", false, Drawing::Blended),
                ("depth", true, Drawing::Blended),
                ("ellipsoids", true, Drawing::Ellipsoids),
            ] {
                let antialias = self.settings.antialias;
                let features = Features { sh_degree: degree as u32, antialias, depth };
                views.push((format!("{name} {degree}"), View::new(features, drawing)));
            }
        }
        let settings = &self.settings;
        let blended = Frame {
            background: settings.background,
            // WGSL and JSON have no infinities.
            far: settings.far.min(f32::MAX),
            eps2d: settings.eps2d,
            alpha_max: settings.alpha_max,
            alpha_min: settings.alpha_min,
            transmittance_min: settings.transmittance_min,
            compensation_min: settings.compensation_min,
            ellipsoid_sigma: ELLIPSOID_SIGMA,
        };
        let solid = Frame { alpha_min: ELLIPSOID_OPACITY_MIN, ..blended };
        Data {
            title: self.title,
            table: Table::new(views),
            present: PRESENT,
            degrees,
            frames: BTreeMap::from([("colour", blended), ("depth", blended), ("ellipsoids", solid)]),
            near: NearRule {
                fixed: (self.near == Near::OfSettings).then_some(settings.near),
                share: NEAR_SHARE,
                sample: NEAR_SAMPLE,
                fallback: RenderSettings::default().near,
                least: f32::MIN_POSITIVE,
                far: RenderSettings::default().far,
            },
            slope_margin: SLOPE_MARGIN,
            shots: self.shots.iter().map(shot_data).collect(),
            start: self.start,
            scene: Header::new(self.gaussians, self.precision),
        }
    }
}

fn shot_data(shot: &Shot) -> ShotData<'_> {
    let photograph = shot.photograph.as_deref().map(data_url);
    ShotData { name: &shot.name, camera: CameraData::new(&shot.camera), photograph }
}

fn data_url(jpeg: &[u8]) -> String {
    format!("data:image/jpeg;base64,{}", STANDARD.encode(jpeg))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn page<'a>(title: &'a str, gaussians: &'a Gaussians) -> Page<'a> {
        let (settings, near) = (RenderSettings::default(), Near::default());
        Page {
            title,
            gaussians,
            shots: &[],
            start: 0,
            stills: &[],
            settings,
            near,
            precision: Precision::Full,
        }
    }

    #[test]
    fn every_place_is_filled_and_no_text_ends_a_script() {
        let scene = Gaussians::empty(1).unwrap();
        let html = page("</script><b>{{scene}}", &scene).html().unwrap();
        assert!(!html.contains("{{title}}") && !html.contains("{{data}}"));
        assert!(html.contains("&lt;/script&gt;&lt;b&gt;{{scene}}"));
        assert_eq!(html.matches("</script>").count(), 3, "data, scene, script");
        assert!(!html.contains("http://") && !html.contains("https://"));
    }

    #[test]
    fn a_page_has_views_for_its_degree_and_for_the_highest() {
        for (degree, expected) in [(0, vec![0, 3]), (2, vec![2, 3]), (3, vec![3])] {
            let scene = Gaussians::empty(degree).unwrap();
            let data = serde_json::to_value(page("x", &scene).data()).unwrap();
            assert_eq!(data["degrees"], serde_json::json!(expected));
            let views = data["table"]["views"].as_object().unwrap();
            assert_eq!(views.len(), 3 * expected.len());
        }
    }

    #[test]
    fn a_scene_beside_the_page_is_not_in_it() {
        let mut scene = Gaussians::empty(0).unwrap();
        scene.push([1.0, 2.0, 3.0], [1.0, 0.0, 0.0, 0.0], [0.0; 3], 0.0, &[0.0; 3]);
        let page = page("x", &scene);
        let (html, bytes) = page.html_beside("scene.bin").unwrap();
        assert!(html.contains("data-source=\"scene.bin\"></script>"));
        assert_eq!(bytes, packed(&scene, Precision::Full));
        assert!(page.html().unwrap().contains(&STANDARD.encode(&bytes)));
    }
}
