//! Charts of configurations over time, as SVG: a panel a joint, one above the other, with a band of
//! uncertainty where one is known. Angles in degrees, lengths in centimetres.

use super::draw::Rgb;
use super::units::turns;
use linkage_skill::object::JointKind;
use plotters::coord::Shift;
use plotters::prelude::*;

/// Size of a panel, pixels; a page makes it as narrow as the screen.
const PANEL: (u32, u32) = (480, 250);
/// Time without a configuration at which a curve breaks off, seconds.
const PAUSE_S: f64 = 0.5;
/// Share of the range of the configurations that a band may reach beyond it in the chart.
const MOST_BAND: f64 = 0.2;
/// Lines of the grid, on light and on dark ground.
const GREY: RGBColor = RGBColor(128, 128, 128);

/// What a curve is drawn on.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Ground {
    /// That of the page that holds it.
    Page,
    /// White: a file of its own.
    White,
}

/// The configuration of a joint over time.
#[derive(Debug, Clone)]
pub struct Curve {
    /// Type of the joint.
    pub kind: JointKind,
    /// Colour of its part.
    pub colour: Rgb,
    /// `[t, q]`: seconds, and radians or metres.
    pub points: Vec<[f64; 2]>,
    /// Standard deviation of each point, radians or metres, where it is known.
    pub deviations: Vec<Option<f64>>,
}

/// Curves below each other; time begins at 0 with the first point of all.
pub fn svg(curves: &[Curve], ground: Ground) -> anyhow::Result<String> {
    let shown: Vec<&Curve> = curves.iter().filter(|c| !c.points.is_empty()).collect();
    let mut text = String::new();
    if shown.is_empty() {
        return Ok("<svg xmlns=\"http://www.w3.org/2000/svg\"/>".to_owned());
    }
    let times = || shown.iter().flat_map(|c| &c.points).map(|p| p[0]);
    let start = times().fold(f64::INFINITY, f64::min);
    let end = times().fold(f64::NEG_INFINITY, f64::max);
    let seconds = if end > start { end - start } else { 1.0 };
    {
        let size = (PANEL.0, PANEL.1 * shown.len() as u32);
        let area = SVGBackend::with_string(&mut text, size).into_drawing_area();
        if ground == Ground::White {
            area.fill(&WHITE)?;
        }
        for (panel, curve) in area.split_evenly((shown.len(), 1)).iter().zip(&shown) {
            draw(panel, curve, start, seconds)?;
        }
        area.present()?;
    }
    Ok(text)
}

fn draw(
    area: &DrawingArea<SVGBackend<'_>, Shift>,
    curve: &Curve,
    start: f64,
    seconds: f64,
) -> anyhow::Result<()> {
    let (unit, name) =
        if turns(curve.kind) { (1_f64.to_degrees(), "degrees") } else { (100.0, "cm") };
    let (bottom, top) = limits(curve, unit);
    let mut chart = ChartBuilder::on(area)
        .margin(10)
        .x_label_area_size(50)
        .y_label_area_size(74)
        .build_cartesian_2d(0.0..seconds, bottom..top)?;
    chart
        .configure_mesh()
        .axis_style(GREY)
        .bold_line_style(GREY.mix(0.3))
        .light_line_style(TRANSPARENT)
        .label_style(("sans-serif", 19))
        .x_labels(6)
        .y_labels(5)
        .x_desc("seconds")
        .y_desc(name)
        .draw()?;
    let [r, g, b] = curve.colour;
    let colour = RGBColor(r, g, b);
    for piece in pieces(curve) {
        let place = |&(t, q, _): &(f64, f64, Option<f64>)| (t - start, unit * q);
        let edge = |p: &(f64, f64, Option<f64>), sign: f64| {
            let (t, q) = place(p);
            (t, (q + sign * unit * p.2.unwrap_or(0.0)).clamp(bottom, top))
        };
        // Where a deviation is not known there is no band, and none across such a gap.
        for known in piece.chunk_by(|a, b| a.2.is_some() == b.2.is_some()) {
            if known.len() < 2 || known[0].2.is_none() {
                continue;
            }
            let upper = known.iter().map(|p| edge(p, 1.0));
            let lower = known.iter().rev().map(|p| edge(p, -1.0));
            let outline: Vec<(f64, f64)> = upper.chain(lower).collect();
            chart.draw_series([Polygon::new(outline, colour.mix(0.3))])?;
        }
        chart.draw_series(LineSeries::new(piece.iter().map(place), colour.stroke_width(3)))?;
    }
    Ok(())
}

/// The least and the greatest value of the chart: of the configurations, and of their band where it is not too wide.
fn limits(curve: &Curve, unit: f64) -> (f64, f64) {
    let values = || curve.points.iter().map(|p| unit * p[1]);
    let (low, high) =
        (values().fold(f64::INFINITY, f64::min), values().fold(f64::NEG_INFINITY, f64::max));
    let beyond = |sign: f64, end: f64| {
        let reach = values()
            .zip(&curve.deviations)
            .filter_map(|(q, d)| Some(sign * (q - end) + unit * (*d)?));
        reach.fold(0.0, f64::max).min(MOST_BAND * (high - low))
    };
    let pad = if high > low { 0.08 * (high - low) } else { 1.0 };
    (low - beyond(-1.0, low) - pad, high + beyond(1.0, high) + pad)
}

/// The pieces of a curve between pauses: time, configuration, deviation.
fn pieces(curve: &Curve) -> Vec<Vec<(f64, f64, Option<f64>)>> {
    let mut pieces: Vec<Vec<(f64, f64, Option<f64>)>> = Vec::new();
    for (i, &[t, q]) in curve.points.iter().enumerate() {
        let deviation = curve.deviations.get(i).copied().flatten();
        match pieces.last_mut() {
            Some(piece) if piece.last().is_some_and(|p| t - p.0 <= PAUSE_S) => {
                piece.push((t, q, deviation));
            }
            _ => pieces.push(vec![(t, q, deviation)]),
        }
    }
    pieces
}

#[cfg(test)]
mod tests {
    use super::*;

    fn curve(times: &[f64], deviation: Option<f64>) -> Curve {
        Curve {
            kind: JointKind::Revolute,
            colour: [1, 2, 3],
            points: times.iter().map(|&t| [t, 0.1 * t]).collect(),
            deviations: vec![deviation; times.len()],
        }
    }

    #[test]
    fn a_curve_breaks_off_where_nothing_is_known_for_long() {
        let broken = curve(&[0.0, 0.1, 0.2, 3.0, 3.1], None);
        let lengths: Vec<usize> = pieces(&broken).iter().map(Vec::len).collect();
        assert_eq!(lengths, [3, 2]);
    }

    #[test]
    fn a_band_is_drawn_where_deviations_are_known() {
        let bands = |d| {
            let text = svg(&[curve(&[0.0, 0.1, 0.2], d)], Ground::Page).unwrap();
            text.matches("<polygon").count()
        };
        assert_eq!((bands(None), bands(Some(0.01))), (0, 1));
    }

    #[test]
    fn no_band_is_drawn_across_a_gap_in_what_is_known() {
        let times: Vec<f64> = (0..6).map(|i| 0.1 * f64::from(i)).collect();
        let known = [true, true, false, false, true, true];
        let deviations = known.iter().map(|k| k.then_some(0.01)).collect();
        let text = svg(&[Curve { deviations, ..curve(&times, None) }], Ground::Page).unwrap();
        assert_eq!(text.matches("<polygon").count(), 2);
    }

    #[test]
    fn a_band_that_is_not_too_wide_has_its_place_in_the_chart() {
        let (narrow, wide) = (curve(&[0.0, 10.0], Some(0.1)), curve(&[0.0, 10.0], Some(9.0)));
        let ends = |curve| {
            let (bottom, top) = limits(curve, 1.0);
            [bottom, top].map(|x| (100.0 * x).round() / 100.0)
        };
        assert_eq!(ends(&narrow), [-0.18, 1.18]);
        assert_eq!(ends(&wide), [-0.28, 1.28]);
    }

    #[test]
    fn one_point_or_none_is_no_failure() {
        for times in [&[][..], &[1.0]] {
            assert!(svg(&[curve(times, None)], Ground::White).unwrap().starts_with("<svg"));
        }
    }
}
