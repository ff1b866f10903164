//! Pages that a person reads: of a demonstration, a recognition, a prediction. They are whole HTML, say
//! in their first sentence what was learned, why a thing was refused, and fit a telephone.
//!
//! The picture at the top of the README is the demo's own. Where the demo has changed, this puts the new
//! one there: `LINKAGE_BLESS=1 cargo test --release -p linkage-tests --test report the_demo`.

use linkage_driver::jpeg;
use linkage_tests::{failure, linkage, simulated};
use quick_xml::Reader;
use quick_xml::events::Event;
use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::OnceLock;

/// Width of a telephone, CSS pixels.
const TELEPHONE_PX: u32 = 390;
/// Elements of HTML that have no end.
const VOID: [&str; 5] = ["meta", "link", "img", "br", "hr"];

/// Pages of a simulated fridge, made once for all tests.
struct Pages {
    dir: tempfile::TempDir,
}

impl Pages {
    fn path(&self, name: &str) -> PathBuf {
        self.dir.path().join(name)
    }

    fn text(&self, name: &str) -> String {
        fs::read_to_string(self.path(name)).expect("the page was written")
    }
}

fn pages() -> &'static Pages {
    static PAGES: OnceLock<Pages> = OnceLock::new();
    PAGES.get_or_init(|| {
        let pages = Pages { dir: tempfile::tempdir().expect("a scratch folder can be made") };
        let seen = text(&simulated("fridge", false, 1));
        let met = text(&simulated("fridge", true, 3));
        let hand = text(&simulated("hand_only", false, 1));
        let store = text(&pages.path("objects.linkage"));
        let page = |name: &str| text(&pages.path(name));
        let learned = page("learned.html");
        run(&["learn", &seen, "--object", "<fridge>", "--store", &store, "--report", &learned], 0);
        run(&["recognise", &met, "--store", &store, "--report", &page("recognised.html")], 0);
        run(&["predict", &met, "--store", &store, "--report", &page("predicted.html")], 0);
        let nothing = page("nothing.html");
        run(&["learn", &hand, "--object", "hand", "--no-store", "--report", &nothing], 1);
        run(&["recognise", &hand, "--store", &store, "--report", &page("unknown.html")], 1);
        pages
    })
}

fn text(path: &Path) -> String {
    path.display().to_string()
}

/// Runs a command that ends with a status.
fn run(arguments: &[&str], status: i32) {
    let output = linkage(&[arguments, &["--quiet"]].concat());
    let (ended, said) = failure(&output);
    assert_eq!(ended, status, "{arguments:?}: {said}");
}

const ALL: [&str; 5] =
    ["learned.html", "recognised.html", "predicted.html", "nothing.html", "unknown.html"];

/// What the text of the first element of a class is.
fn first_of_class<'p>(page: &'p str, class: &str) -> Option<&'p str> {
    let after = page.split_once(&format!("class=\"{class}\">"))?.1;
    Some(after.split_once('<')?.0)
}

/// The first fault in the nesting or the attributes of a page; `None` where it is well formed.
fn fault(page: &str) -> Option<String> {
    let mut reader = Reader::from_str(page);
    reader.config_mut().check_end_names = false;
    reader.config_mut().allow_unmatched_ends = true;
    let mut open: Vec<String> = Vec::new();
    loop {
        match reader.read_event() {
            Err(error) => return Some(error.to_string()),
            Ok(Event::Eof) => return open.pop().map(|element| format!("<{element}> has no end")),
            Ok(Event::Start(start)) => {
                if let Some(error) = start.attributes().find_map(Result::err) {
                    return Some(error.to_string());
                }
                let element = start.name().as_ref().to_owned();
                if !VOID.contains(&element.as_str()) {
                    open.push(element);
                }
            }
            Ok(Event::End(end)) => {
                let element = end.name().as_ref().to_owned();
                if open.pop().as_ref() != Some(&element) {
                    return Some(format!("</{element}> ends another element"));
                }
            }
            Ok(_) => {}
        }
    }
}

#[test]
fn pages_are_well_formed_and_need_no_other_file() {
    assert!(fault("<p><b>x</p></b>").is_some() && fault("<p>").is_some());
    assert_eq!(fault("<p>x<img alt=\"y\"></p>"), None);
    for name in ALL {
        let page = pages().text(name);
        assert_eq!(fault(&page), None, "{name}");
        assert!(page.starts_with("<!DOCTYPE html>"), "{name}");
        assert!(page.contains("name=\"viewport\""), "{name}");
        for outside in ["src=\"http", "href=\"http", "url(", "@import", "<script"] {
            assert!(!page.contains(outside), "{name} holds {outside}");
        }
    }
}

#[test]
fn the_first_sentence_says_what_was_learned_and_how_far_it_opens() {
    let page = pages().text("learned.html");
    let said = first_of_class(&page, "lead").expect("there is a first sentence");
    // The fridge is hinged on the right in this recording.
    assert!(said.starts_with("A door, hinged on the right, opens "), "{said}");
    let opened = said.split_once("opens ").and_then(|(_, rest)| rest.split_once('°'));
    let degrees: f64 = opened.expect("it tells an angle").0.parse().expect("a number");
    assert!((degrees - truth_degrees()).abs() < 4.0, "{said} and not {}", truth_degrees());
    assert!(page.contains("Sure of the type: ") && page.contains("Direction ± "));
    assert!(page.contains("tracked features"), "it says what it was learned from");
    assert!(page.contains("&lt;fridge&gt;") && !page.contains("<fridge>"));
}

/// How far the simulator opened the fridge.
fn truth_degrees() -> f64 {
    let truth = fs::read_to_string(simulated("fridge", false, 1).join("truth.json")).unwrap();
    let truth: serde_json::Value = serde_json::from_str(&truth).unwrap();
    let configuration = truth["joints"][0]["configuration"].as_array().unwrap();
    let values: Vec<f64> = configuration.iter().filter_map(|q| q.as_f64()).collect();
    let (low, high) =
        values.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), q| (l.min(*q), h.max(*q)));
    (high - low).to_degrees()
}

#[test]
fn the_motion_is_shown_in_a_film_strip_and_over_time_with_its_band() {
    let page = pages().text("learned.html");
    let strip = page.split_once("class=\"strip\"").expect("there is a strip").1;
    let strip = strip.split_once("</div>").expect("it ends").0;
    let frames = strip.matches("data:image/jpeg;base64,").count();
    assert!((5..=7).contains(&frames), "{frames} frames");
    assert!(page.contains("<svg") && page.contains("<polygon"), "a curve and its band");
    assert!(page.contains("Where the time went") && page.contains("moves by joint1"));
}

#[test]
fn where_a_hand_alone_moves_the_page_says_so() {
    let page = pages().text("nothing.html");
    assert_eq!(first_of_class(&page, "lead"), Some("Nothing articulated moves."));
    assert!(page.contains("<details class=\"refused\">") || page.contains("Nothing was refused"));
}

#[test]
fn what_was_refused_is_told_with_its_reason_and_limit() {
    let page = pages().text("learned.html");
    let refused = page.split_once("<details class=\"refused\">").expect("they are listed").1;
    let refused = refused.split_once("</details>").expect("the list ends").0;
    let first = refused.split_once("<li>").expect("there is one").1;
    let first = first.split_once("</li>").expect("it ends").0;
    assert!(first.contains(" tracks, ") && first.contains(" frames): "), "{first}");
    let reason = first.split_once("frames): ").expect("it has a reason").1;
    assert!(reason.chars().any(|c| c.is_ascii_digit()) && reason.ends_with('.'), "{reason}");
}

/// The most that a page with an animation may take.
const MOST_BYTES: usize = 1_500_000;

#[test]
fn what_moves_is_shown_moving_and_as_a_still_on_paper_and_for_who_wants_no_motion() {
    for name in ["learned.html", "predicted.html"] {
        let page = pages().text(name);
        assert!(page.len() < MOST_BYTES, "{name}: {} bytes", page.len());
        let animation = page.split_once("class=\"animation\"").expect("there is an animation").1;
        let animation = animation.split_once("</div>").expect("it ends").0;
        let pictures: Vec<&str> = animation.split("<img").skip(1).collect();
        assert!(pictures.len() >= 8, "{name}: {} pictures", pictures.len());
        let different: BTreeSet<&str> =
            pictures.iter().filter_map(|p| p.split_once("base64,")?.1.split('"').next()).collect();
        assert!(different.len() * 2 > pictures.len(), "{name}: the pictures are the same");
        assert_eq!(pictures.iter().filter(|p| p.contains("class=\"still\"")).count(), 1, "{name}");
        for medium in ["(prefers-reduced-motion: reduce)", "print"] {
            let rules = page.split_once(&format!("@media {medium} {{")).expect("it has rules").1;
            let rules = rules.split_once("\n}").expect("they end").0;
            assert!(rules.contains(".animation img { animation: none; }"), "{name}, {medium}");
            assert!(
                rules.contains(".animation img.still { visibility: visible; }"),
                "{name}, {medium}"
            );
        }
    }
}

#[test]
fn a_recognition_tells_its_joints_and_an_unknown_thing_how_near_it_came() {
    let page = pages().text("recognised.html");
    let said = first_of_class(&page, "lead").expect("there is a first sentence");
    assert!(said.starts_with("&lt;fridge&gt; is recognised: "), "{said}");
    assert!(page.contains("joint1, a hinge, is at ") && page.contains(" that were learned."));
    let unknown = pages().text("unknown.html");
    assert_eq!(first_of_class(&unknown, "lead"), Some("Nothing is recognised."));
    assert!(unknown.contains("an object is reported from 50 % on."));
}

#[test]
fn a_prediction_tells_from_where_to_where_a_joint_goes() {
    let page = pages().text("predicted.html");
    let said = first_of_class(&page, "lead").expect("there is a first sentence");
    assert!(said.starts_with("joint1, a hinge, goes from ") && said.ends_with(" s."), "{said}");
    assert!(page.contains("as planned") && page.contains("greatest speed"));
}

/// The most that a picture of the README may take.
const MOST_PICTURE_BYTES: usize = 300_000;
/// Mean difference of pixels, of 255, from which the README's picture shows another demo. An old one, with
/// outlines in place of surfaces, had 3.6.
const OLD_PICTURE: f64 = 2.0;

#[test]
fn the_demo_ends_with_one_page_of_the_whole_pipeline_and_with_the_readmes_picture() {
    let dir = tempfile::tempdir().expect("a scratch folder can be made");
    run(&["demo", "--out", &text(dir.path())], 0);
    let page = fs::read_to_string(dir.path().join("index.html")).expect("the page was written");
    assert_eq!(fault(&page), None);
    assert!(page.len() < MOST_BYTES, "{} bytes", page.len());
    let sections = ["1. A person moves it once", "2. It is met again", "3. How it will move"];
    let places: Vec<usize> =
        sections.iter().map(|c| page.find(c).unwrap_or_else(|| panic!("no {c}"))).collect();
    assert!(places.is_sorted(), "{places:?}");
    for told in
        ["A door, hinged ", "fridge is recognised: ", ", a hinge, goes from ", "axis off by "]
    {
        assert!(page.contains(told), "it does not tell {told:?}");
    }
    assert_eq!(page.matches("class=\"animation\"").count(), 2);
    let mut links = 0;
    for link in page.split("<a href=\"").skip(1) {
        let file = link.split('"').next().unwrap_or_default();
        assert!(dir.path().join(file).is_file(), "{file} is not there");
        links += 1;
    }
    assert_eq!(links, 3);
    assert_is_readmes_picture(&dir.path().join("demo.jpg"));
}

/// Compares the demo's picture with the one that the README shows; puts it in its place where that is
/// asked for by `LINKAGE_BLESS=1`.
fn assert_is_readmes_picture(made: &Path) {
    let kept = Path::new(env!("CARGO_MANIFEST_DIR")).join("../tools/demo.jpg");
    if std::env::var_os("LINKAGE_BLESS").is_some() {
        fs::copy(made, &kept).expect("the repository can be written");
    }
    let [now, before] = [made, &kept].map(|path| {
        let bytes = fs::read(path).expect("the picture is there");
        assert!((10_000..MOST_PICTURE_BYTES).contains(&bytes.len()), "{}", path.display());
        let size = jpeg::size(&bytes).expect("it is a JPEG");
        jpeg::decode(&bytes, size).expect("it is a JPEG")
    });
    assert_eq!((now.width(), now.height()), (before.width(), before.height()));
    let levels = now.as_rgb().iter().zip(before.as_rgb()).map(|(a, b)| u64::from(a.abs_diff(*b)));
    let off = levels.sum::<u64>() as f64 / now.as_rgb().len() as f64;
    assert!(off < OLD_PICTURE, "tools/demo.jpg is old, {off:.2}: see the head of this file");
}

/// What a browser says of a page as wide as a telephone.
struct Shown {
    scroll_width_px: u32,
    console: Vec<String>,
}

/// Shows a page in a headless Chromium; `None`, with a message, where there is none.
fn shown(page: &Path) -> Option<Shown> {
    if !Command::new("chromium").arg("--version").output().is_ok_and(|o| o.status.success()) {
        eprintln!("ignored: there is no chromium on PATH; apt-get install chromium");
        return None;
    }
    let dir = tempfile::tempdir().expect("a scratch folder can be made");
    // A browser's window cannot be as narrow as a telephone; a frame in it can.
    let frame = dir.path().join("frame.html");
    let html = format!(
        "<!DOCTYPE html><title>-</title><iframe id=\"f\" src=\"file://{}\" \
         style=\"width:{TELEPHONE_PX}px;height:800px;border:0\"></iframe><script>\
         addEventListener('load', () => {{ document.title = 'width=' + \
         document.getElementById('f').contentDocument.documentElement.scrollWidth + ';'; }});\
         </script>",
        page.display()
    );
    fs::write(&frame, html).expect("a scratch file can be written");
    let output = Command::new("timeout")
        .args(["120", "chromium", "--headless", "--no-sandbox", "--disable-gpu"])
        .args(["--allow-file-access-from-files", "--enable-logging=stderr", "--dump-dom"])
        .arg(format!("--user-data-dir={}", dir.path().join("profile").display()))
        .arg(format!("file://{}", frame.display()))
        .output()
        .expect("timeout is part of coreutils");
    let (dom, log) =
        (String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    let width = dom.split_once("width=").and_then(|(_, rest)| rest.split_once(';'));
    let width = width.unwrap_or_else(|| panic!("chromium shows nothing: {log}")).0;
    Some(Shown {
        scroll_width_px: width.parse().expect("a width is a number"),
        console: log.lines().filter(|l| l.contains("CONSOLE")).map(str::to_owned).collect(),
    })
}

#[test]
fn a_telephone_shows_pages_without_scrolling_sideways_and_without_errors() {
    let broken = pages().path("broken.html");
    let wide = "<!DOCTYPE html><div style=\"width:600px\">x</div><script>y.z</script>";
    fs::write(&broken, wide).expect("a scratch file can be written");
    let Some(shown_broken) = shown(&broken) else { return };
    assert!(shown_broken.scroll_width_px >= 600 && !shown_broken.console.is_empty());
    for name in ALL {
        let page = shown(&pages().path(name)).expect("chromium is there");
        assert!(page.scroll_width_px <= TELEPHONE_PX, "{name}: {} px", page.scroll_width_px);
        assert!(page.console.is_empty(), "{name}: {:?}", page.console);
    }
}
