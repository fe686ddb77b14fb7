use gs_scene::*;
pub(crate) fn bank(v: &View, _d: &DepthMap, _c: &[f32]) -> crate::Result<FeatureMap> {
    Ok(FeatureMap::new(
        1,
        v.image().width(),
        v.image().height(),
        v.image().luma(),
    )?)
}
