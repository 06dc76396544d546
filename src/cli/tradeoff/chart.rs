//! Panels of points on logarithmic axes, as SVG and as PNG. The chart is laid out once as lines, discs
//! and words, which are then written in either format.

use std::fmt::Write;

use super::super::Error;

/// A chart of panels side by side.
#[derive(Clone, Debug)]
pub(super) struct Chart {
    pub(super) panels: Vec<Panel>,
}

/// A panel: two logarithmic axes and the series drawn on them.
#[derive(Clone, Debug)]
pub(super) struct Panel {
    pub(super) title: &'static str,
    pub(super) x: &'static str,
    pub(super) series: Vec<Series>,
}

/// Points of one kind. Both coordinates are positive.
#[derive(Clone, Debug)]
pub(super) struct Series {
    name: String,
    points: Vec<(f64, f64)>,
    mark: Mark,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Mark {
    Cloud,
    Line,
    Named,
    Other,
}

impl Series {
    /// Many small points.
    pub(super) fn cloud(points: Vec<(f64, f64)>) -> Self {
        Self { name: String::new(), points, mark: Mark::Cloud }
    }

    /// Points joined by a line.
    pub(super) fn line(points: Vec<(f64, f64)>) -> Self {
        Self { name: String::new(), points, mark: Mark::Line }
    }

    /// One large point with its name beside it.
    pub(super) fn named(name: impl Into<String>, point: (f64, f64)) -> Self {
        Self { name: name.into(), points: vec![point], mark: Mark::Named }
    }

    /// One large point with its name, in the colour of other libraries.
    pub(super) fn other(name: impl Into<String>, point: (f64, f64)) -> Self {
        Self { mark: Mark::Other, ..Self::named(name, point) }
    }
}

const PANEL: (f64, f64) = (460.0, 360.0);
/// Margins of a panel: left, top, right, bottom.
const FRAME: (f64, f64, f64, f64) = (64.0, 34.0, 20.0, 46.0);

type Colour = [u8; 3];
const INK: Colour = [40, 40, 40];
const GRID: Colour = [225, 225, 225];
const CLOUD: Colour = [150, 180, 215];
const LINE: Colour = [200, 60, 40];
const NAMED: Colour = [20, 90, 50];
const OTHER: Colour = [130, 40, 140];

/// An element of the page. Coordinates are pixels from the top left.
enum Shape {
    Line {
        from: (f64, f64),
        to: (f64, f64),
        colour: Colour,
    },
    Disc {
        at: (f64, f64),
        radius: f64,
        colour: Colour,
    },
    /// A line of text that begins at `at`, at half its height; 7 pixels per letter.
    Words {
        at: (f64, f64),
        text: String,
        colour: Colour,
    },
}

const LETTER: f64 = 7.0;
const LINE_HEIGHT: f64 = 12.0;

/// A logarithmic range of values, and the pixels onto which it is mapped.
struct Axis {
    low: f64,
    high: f64,
    from: f64,
    to: f64,
}

impl Axis {
    fn new(values: impl Iterator<Item = f64> + Clone, from: f64, to: f64) -> Self {
        let low = values.clone().fold(f64::INFINITY, f64::min).log10();
        let high = values.fold(0.0, f64::max).log10();
        let (low, high) = if low < high { (low, high) } else { (-1.0, 1.0) };
        let room = 0.04 * (high - low);
        Self { low: low - room, high: high + room, from, to }
    }

    fn at(&self, value: f64) -> f64 {
        self.from + (value.log10() - self.low) / (self.high - self.low) * (self.to - self.from)
    }

    /// The ticks: powers of ten, and also twice and five times those if there are few.
    fn ticks(&self) -> Vec<f64> {
        let span = self.high - self.low;
        let every = (span / 6.0).ceil().max(1.0) as i32;
        let steps: &[f64] = if span < 2.5 { &[1.0, 2.0, 5.0] } else { &[1.0] };
        let exponents =
            (self.low.floor() as i32..=self.high.ceil() as i32).filter(|e| e.rem_euclid(every) == 0);
        let ticks = exponents.flat_map(|e| steps.iter().map(move |step| step * 10_f64.powi(e)));
        ticks.filter(|tick| (self.low..=self.high).contains(&tick.log10())).collect()
    }
}

fn label(value: f64) -> String {
    if (1e-2..1e3).contains(&value) { format!("{value}") } else { format!("{value:.0e}") }
}

impl Chart {
    fn size(&self) -> (f64, f64) {
        (PANEL.0 * self.panels.len() as f64, PANEL.1)
    }

    fn shapes(&self) -> Vec<Shape> {
        let places = (0..self.panels.len()).map(|i| PANEL.0 * i as f64);
        self.panels.iter().zip(places).flat_map(|(panel, left)| panel.shapes(left)).collect()
    }

    /// The chart as SVG text.
    pub(super) fn svg(&self) -> String {
        let (width, height) = self.size();
        let mut svg = format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width} {height}\" \
             font-family=\"monospace\" font-size=\"11.6\">\n<rect width=\"100%\" height=\"100%\" fill=\"white\"/>\n"
        );
        for shape in self.shapes() {
            let _ = match shape {
                Shape::Line { from, to, colour } => writeln!(
                    svg,
                    "<line x1=\"{:.1}\" y1=\"{:.1}\" x2=\"{:.1}\" y2=\"{:.1}\" stroke=\"{}\"/>",
                    from.0,
                    from.1,
                    to.0,
                    to.1,
                    hex(colour)
                ),
                Shape::Disc { at, radius, colour } => writeln!(
                    svg,
                    "<circle cx=\"{:.1}\" cy=\"{:.1}\" r=\"{radius}\" fill=\"{}\"/>",
                    at.0,
                    at.1,
                    hex(colour)
                ),
                Shape::Words { at, text, colour } => writeln!(
                    svg,
                    "<text x=\"{:.1}\" y=\"{:.1}\" fill=\"{}\">{text}</text>",
                    at.0,
                    at.1 + 4.0,
                    hex(colour)
                ),
            };
        }
        svg + "</svg>\n"
    }

    /// The chart as a PNG image, with two pixels per unit.
    ///
    /// # Errors
    /// No error is expected.
    pub(super) fn png(&self) -> Result<Vec<u8>, Error> {
        let mut canvas = Canvas::new(self.size());
        for shape in self.shapes() {
            canvas.draw(&shape);
        }
        let mut bytes = Vec::new();
        let mut encoder = png::Encoder::new(&mut bytes, canvas.width as u32, canvas.height as u32);
        encoder.set_color(png::ColorType::Rgb);
        encoder.set_depth(png::BitDepth::Eight);
        let mut writer = encoder.write_header()?;
        writer.write_image_data(canvas.pixels.as_flattened())?;
        writer.finish()?;
        Ok(bytes)
    }
}

fn hex([r, g, b]: Colour) -> String {
    format!("#{r:02x}{g:02x}{b:02x}")
}

impl Panel {
    fn shapes(&self, left: f64) -> Vec<Shape> {
        let (x0, x1) = (left + FRAME.0, left + PANEL.0 - FRAME.2);
        let (y0, y1) = (PANEL.1 - FRAME.3, FRAME.1);
        let points = self.series.iter().flat_map(|series| &series.points);
        let x = Axis::new(points.clone().map(|p| p.0), x0, x1);
        let y = Axis::new(points.map(|p| p.1), y0, y1);
        let words = |at, text: &str, colour| Shape::Words { at, text: text.into(), colour };
        let mut shapes = Vec::new();
        for tick in x.ticks() {
            let (at, text) = (x.at(tick), label(tick));
            shapes.push(Shape::Line { from: (at, y0), to: (at, y1), colour: GRID });
            shapes.push(words((at - 0.5 * LETTER * text.len() as f64, y0 + 12.0), &text, INK));
        }
        for tick in y.ticks() {
            let (at, text) = (y.at(tick), label(tick));
            shapes.push(Shape::Line { from: (x0, at), to: (x1, at), colour: GRID });
            shapes.push(words((x0 - 6.0 - LETTER * text.len() as f64, at), &text, INK));
        }
        for (from, to) in [((x0, y0), (x1, y0)), ((x0, y0), (x0, y1))] {
            shapes.push(Shape::Line { from, to, colour: INK });
        }
        shapes.push(words((x0, 14.0), self.title, INK));
        shapes.push(words((x0, PANEL.1 - 12.0), self.x, INK));
        // The positions at which the names written so far begin, and their lengths.
        let mut written: Vec<((f64, f64), f64)> = Vec::new();
        for series in &self.series {
            let at: Vec<(f64, f64)> = series.points.iter().map(|p| (x.at(p.0), y.at(p.1))).collect();
            match series.mark {
                Mark::Cloud => {
                    shapes.extend(at.iter().map(|&at| Shape::Disc { at, radius: 1.2, colour: CLOUD }));
                }
                Mark::Line => {
                    let joined = at.windows(2);
                    shapes.extend(joined.map(|two| Shape::Line { from: two[0], to: two[1], colour: LINE }));
                    shapes.extend(at.iter().map(|&at| Shape::Disc { at, radius: 2.2, colour: LINE }));
                }
                Mark::Named | Mark::Other => {
                    let colour = if series.mark == Mark::Named { NAMED } else { OTHER };
                    for &at in &at {
                        shapes.push(Shape::Disc { at, radius: 3.5, colour });
                        let length = LETTER * series.name.len() as f64;
                        let left = if at.0 + 6.0 + length < x1 { at.0 + 6.0 } else { at.0 - 6.0 - length };
                        let mut beside = (left, at.1 - 6.0);
                        // Move the name down until it hides no other one.
                        let hides = |&(there, its): &((f64, f64), f64), here: (f64, f64)| {
                            (there.1 - here.1).abs() < LINE_HEIGHT
                                && there.0 < here.0 + length
                                && here.0 < there.0 + its
                        };
                        while written.iter().any(|label| hides(label, beside)) {
                            beside.1 += LINE_HEIGHT;
                        }
                        written.push((beside, length));
                        shapes.push(words(beside, &series.name, colour));
                    }
                }
            }
        }
        shapes
    }
}

/// An image with two pixels per unit.
struct Canvas {
    width: usize,
    height: usize,
    pixels: Vec<Colour>,
}

const SCALE: f64 = 2.0;

impl Canvas {
    fn new((width, height): (f64, f64)) -> Self {
        let (width, height) = ((SCALE * width) as usize, (SCALE * height) as usize);
        Self { width, height, pixels: vec![[255; 3]; width * height] }
    }

    fn set(&mut self, x: f64, y: f64, colour: Colour) {
        if x >= 0.0 && y >= 0.0 && (x as usize) < self.width && (y as usize) < self.height {
            self.pixels[y as usize * self.width + x as usize] = colour;
        }
    }

    fn draw(&mut self, shape: &Shape) {
        match *shape {
            Shape::Line { from, to, colour } => {
                let (dx, dy) = (to.0 - from.0, to.1 - from.1);
                let steps = (SCALE * dx.abs().max(dy.abs())).ceil().max(1.0);
                for i in 0..=steps as usize {
                    let t = i as f64 / steps;
                    self.set(SCALE * (from.0 + t * dx), SCALE * (from.1 + t * dy), colour);
                }
            }
            Shape::Disc { at, radius, colour } => {
                let reach = SCALE * radius;
                let whole = reach.ceil() as i32;
                for (dx, dy) in (-whole..=whole).flat_map(|dx| (-whole..=whole).map(move |dy| (dx, dy))) {
                    let (dx, dy) = (f64::from(dx), f64::from(dy));
                    if dx.hypot(dy) <= reach {
                        self.set(SCALE * at.0 + dx, SCALE * at.1 + dy, colour);
                    }
                }
            }
            Shape::Words { at, ref text, colour } => {
                for (i, letter) in text.chars().enumerate() {
                    let rows =
                        font8x8::legacy::BASIC_LEGACY.get(letter as usize).copied().unwrap_or_default();
                    let left = SCALE * (at.0 + LETTER * i as f64);
                    let top = SCALE * at.1 - 8.0;
                    for (pixel, (row, column)) in
                        (0..8).flat_map(|row| (0..8).map(move |column| (row, column))).enumerate()
                    {
                        if rows[pixel / 8] >> column & 1 == 1 {
                            // Letters are twice as high as wide.
                            let (x, y) = (left + 1.5 * f64::from(column), top + 2.0 * f64::from(row));
                            for (dx, dy) in [(0.0, 0.0), (0.0, 1.0), (0.75, 0.0), (0.75, 1.0)] {
                                self.set(x + dx, y + dy, colour);
                            }
                        }
                    }
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Catches an image that cannot be read (a wrong size, no end), a page that is not well formed, points
    /// off their axes (there must be as many discs as points, inside the frame), and names of near points
    /// that are written on each other.
    #[test]
    fn a_chart_is_drawn_either_way() {
        let points: Vec<(f64, f64)> = (0..50).map(|i| (1.1_f64.powi(i), 10_f64.powi(-(i % 16)))).collect();
        let series = vec![
            Series::cloud(points.clone()),
            Series::line(points),
            Series::named("c", (2.0, 1.0)),
            Series::other("cc", (2.1, 1.0)),
        ];
        let panel = Panel { title: "title", x: "x", series };
        let chart = Chart { panels: vec![panel.clone(), panel] };
        let svg = chart.svg();
        assert_eq!(svg.matches("<circle").count(), 2 * 102);
        assert!(svg.ends_with("</svg>\n") && !svg.contains("NaN") && !svg.contains("inf"));
        let mut names = Vec::new();
        for shape in chart.panels[0].shapes(0.0) {
            match shape {
                Shape::Disc { at, .. } => {
                    assert!(
                        (FRAME.0..PANEL.0).contains(&at.0) && (FRAME.1..PANEL.1 - FRAME.3).contains(&at.1)
                    );
                }
                Shape::Words { at, text, .. } if text.starts_with('c') => names.push(at.1),
                _ => (),
            }
        }
        assert!(names[1] >= names[0] + LINE_HEIGHT, "one name on the other: {names:?}");
        let bytes = chart.png().unwrap();
        let mut reader = png::Decoder::new(std::io::Cursor::new(&bytes)).read_info().unwrap();
        let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
        let info = reader.next_frame(&mut pixels).unwrap();
        assert_eq!((info.width, info.height), (1840, 720));
        let of = |colour: Colour| pixels.chunks(3).filter(|pixel| **pixel == colour).count();
        assert!(of(LINE) > 1000 && of(NAMED) > 50 && of(INK) > 1000);
    }
}
