//! The backbone's own head: one Gaussian of every pixel, as the network made them.

use crate::as_photographed::exposed_as;
use crate::looks::look;
use crate::{
    Config, Counts, Error, ExposureGain, Geometry, Prediction, Result, Stage, Stages, exposure, shell,
};
use gs_scene::{Gaussians, SH_C0, View, sh_coefficients};

/// What reports call it.
const NAME: &str = "depthsplat";

/// Joins the Gaussians of all views, brought into the common exposure, and the far shell; the prediction's geometry is left empty.
pub(crate) fn finish(
    views: &[View],
    geometry: &Geometry,
    config: &Config,
    mut stages: Stages<'_>,
) -> Result<Prediction> {
    let Geometry { views: geometry, depth_range, .. } = geometry;
    let (exposed, exposure) = stages.run(Stage::Exposure, || exposure::equalised(views, geometry));
    let shell = stages.run(Stage::Shell, || match config.far_shell {
        true => shell::shell(&exposed, geometry, depth_range.1, usize::MAX),
        false => Gaussians::empty(0),
    })?;
    let mut per_view = Vec::new();
    let gaussians = stages.run(Stage::Decode, || {
        let mut all: Option<Gaussians> = None;
        for (geometry, &exposure) in geometry.iter().zip(&exposure) {
            let mut part = geometry.gaussians.clone().ok_or(Error::NoOwnGaussians)?;
            recolour(&mut part, exposure);
            per_view.push(part.len());
            match &mut all {
                Some(all) => all.append(&part),
                None => all = Some(part),
            }
        }
        let mut all = all.ok_or(Error::NoOwnGaussians)?;
        all.append(&shell.clone().with_sh_degree(all.sh_degree())?);
        exposed_as(config.exposure, all, views, &exposure)
    })?;
    let gaussians = look(gaussians, (views, &exposure), config, &mut stages)?;
    let counts = Counts { total: gaussians.len(), per_view, shell: shell.len() };
    let (depth_range, seconds) = (*depth_range, stages.seconds());
    let (head, geometry) = (NAME.to_owned(), Vec::new());
    Ok(Prediction {
        gaussians,
        head,
        counts,
        tau: None,
        geometry,
        exposure,
        corrected_by: None,
        corrector: None,
        depth_range,
        seconds,
    })
}

/// Brings colours ½ + Σ Y sh into the common exposure: gain · colour + bias.
fn recolour(gaussians: &mut Gaussians, ExposureGain { gain, bias }: ExposureGain) {
    let row = 3 * sh_coefficients(gaussians.sh_degree());
    let constant = (gain * 0.5 + bias - 0.5) / SH_C0;
    for sh in gaussians.buffers_mut().1.chunks_exact_mut(row) {
        sh.iter_mut().for_each(|v| *v *= gain);
        sh[..3].iter_mut().for_each(|v| *v += constant);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use gs_scene::{dc_from_rgb, rgb_from_dc};

    #[test]
    fn colours_take_the_exposure_of_their_view() {
        let mut set = Gaussians::empty(1).unwrap();
        let mut sh = [0.0; 12];
        sh[..3].copy_from_slice(&dc_from_rgb([0.2, 0.5, 0.9]));
        sh[3] = 0.4;
        set.push([0.0; 3], [1.0, 0.0, 0.0, 0.0], [0.0; 3], 0.0, &sh);
        recolour(&mut set, ExposureGain { gain: 1.5, bias: -0.1 });
        let found = rgb_from_dc([set.sh()[0], set.sh()[1], set.sh()[2]]);
        for (found, colour) in found.iter().zip([0.2, 0.5, 0.9]) {
            assert!((found - (1.5 * colour - 0.1)).abs() < 1e-6);
        }
        assert!((set.sh()[3] - 0.6).abs() < 1e-7);
    }
}
