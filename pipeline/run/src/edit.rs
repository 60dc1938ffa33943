//! `--set a.b[2].c=value`: changes to a scene's tree from the command line.
//!
//! The flag's text becomes a source of its own, so that a mistake in it is shown there, and what
//! it sets is read by the same code as the file.

use weald_contract::table::{Entry, Kind, Table};
use weald_contract::{Problem, Problems, Sources, Span, Value};

/// One step of the way to a value: a key, or a place in an array.
#[derive(Clone, Debug, PartialEq)]
enum Step {
    Key(String, Span),
    Index(usize, Span),
}

/// Applies one `path=value` to the tree.
///
/// Tables on the way are made when they are missing; places of an array must exist. A value that
/// is no TOML but a plain word is taken as a text: `render.view=bank`.
pub fn set(root: &mut Value, flag: &str, sources: &mut Sources, problems: &mut Problems) {
    let source = sources.add(format!("--set {flag}"), flag);
    let Some((path, _)) = flag.split_once('=') else {
        let span = Span { source, start: 0, end: flag.len() as u32 };
        let problem = Problem::at(span, "no `=` in what is to be set");
        problems.push(problem.hint("write for instance `--set render.samples=16`"));
        return;
    };
    let edited = steps(source, path)
        .and_then(|steps| Ok((steps, value(source, flag, path.len())?)))
        .and_then(|(steps, value)| put(root, &steps, value));
    if let Err(problem) = edited {
        problems.push(problem);
    }
}

/// Cuts `a.b[2].c` into its steps.
fn steps(source: u32, path: &str) -> Result<Vec<Step>, Problem> {
    let mut steps = Vec::new();
    let mut start = 0;
    for part in path.split('.') {
        let (key, mut rest) = part.split_at(part.find('[').unwrap_or(part.len()));
        let trimmed = key.trim();
        let span = span(source, start, start + key.len());
        if trimmed.is_empty() {
            return Err(Problem::at(span, "an empty name on the way to the value")
                .hint("write for instance `ecosim.step[0].years=80`"));
        }
        steps.push(Step::Key(trimmed.into(), span));
        let mut at = start + key.len();
        while let Some(inner) = rest.strip_prefix('[') {
            let Some((number, after)) = inner.split_once(']') else {
                return Err(Problem::at(
                    self::span(source, at, start + part.len()),
                    "`[` without `]`",
                ));
            };
            let span = self::span(source, at + 1, at + 1 + number.len());
            let index = number.trim().parse().map_err(|_| {
                Problem::at(span, format!("`{number}` is no place in an array"))
                    .hint("places are whole numbers from 0")
            })?;
            steps.push(Step::Index(index, span));
            at += number.len() + 2;
            rest = after;
        }
        start += part.len() + 1;
    }
    Ok(steps)
}

/// Reads what stands after the `=` at byte `equals`.
fn value(source: u32, flag: &str, equals: usize) -> Result<Value, Problem> {
    // A document of the same length with a one-letter key keeps every place where it is.
    let document = format!("k{}{}", " ".repeat(equals.saturating_sub(1)), &flag[equals..]);
    let text = flag[equals + 1..].trim();
    let whole = span(source, equals + 1, flag.len());
    match Value::parse(source, &document) {
        Ok(Value { kind: Kind::Table(mut table), .. }) if table.entries.len() == 1 => {
            Ok(table.entries.remove(0).value)
        }
        // Words that are no TOML are texts; anything with brackets or quotes meant to be TOML.
        _ if !text.is_empty() && !text.contains(['"', '\'', '[', ']', '{', '}', '\n']) => {
            Ok(Value { span: whole, kind: Kind::String(text.into()) })
        }
        Ok(_) => Err(Problem::at(whole, "one value was expected")),
        Err(mut problems) => Err(problems.pop().unwrap_or_else(|| Problem::at(whole, "no value"))),
    }
}

/// Walks down the steps and puts the value at the end.
fn put(node: &mut Value, steps: &[Step], value: Value) -> Result<(), Problem> {
    let Some((step, rest)) = steps.split_first() else {
        *node = value;
        return Ok(());
    };
    let described = node.describe();
    match (step, &mut node.kind) {
        (Step::Key(key, key_span), Kind::Table(table)) => {
            put(entry(table, key, *key_span, value.span), rest, value)
        }
        (Step::Index(index, span), Kind::Array(items)) => {
            let count = items.len();
            let item = items.get_mut(*index).ok_or_else(|| {
                Problem::at(*span, format!("there is no place {index}"))
                    .hint(format!("the array has {count}, counted from 0"))
            })?;
            put(item, rest, value)
        }
        (Step::Key(key, span), _) => Err(Problem::at(
            *span,
            format!("`{key}` is looked for in {described}, which is no table"),
        )),
        (Step::Index(_, span), _) => Err(Problem::at(
            *span,
            format!("a place is looked for in {described}, which is no array"),
        )),
    }
}

/// The entry of a key, made as an empty table if it is missing.
fn entry<'a>(table: &'a mut Table, key: &str, key_span: Span, span: Span) -> &'a mut Value {
    let place = match table.entries.binary_search_by(|entry| entry.key.as_str().cmp(key)) {
        Ok(found) => found,
        Err(place) => {
            let value = Value { span, kind: Kind::Table(Table::default()) };
            table.entries.insert(place, Entry { key: key.into(), key_span, value });
            place
        }
    };
    &mut table.entries[place].value
}

fn span(source: u32, start: usize, end: usize) -> Span {
    Span { source, start: start as u32, end: end as u32 }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn edited(text: &str, flag: &str) -> (serde_json::Value, Vec<String>) {
        let mut sources = Sources::default();
        let source = sources.add("scene.toml", text);
        let mut root = Value::parse(source, text).unwrap();
        let mut problems = Vec::new();
        set(&mut root, flag, &mut sources, &mut problems);
        let told = problems.iter().map(|problem| {
            let span = problem.span.unwrap();
            let token = &flag[span.start as usize..span.end as usize];
            format!("{token}: {problem}")
        });
        (serde_json::to_value(&root).unwrap(), told.collect())
    }

    #[test]
    fn a_value_is_replaced_wherever_it_stands() {
        let text = "[render]\nsamples = 4\n[[ecosim.step]]\nyears = 1\n[[ecosim.step]]\nyears = 2";
        let (tree, problems) = edited(text, "ecosim.step[1].years=80");
        assert_eq!((tree["ecosim"]["step"][1]["years"].clone(), problems.len()), (80.into(), 0));
        let (tree, _) = edited(text, "render.samples = 16");
        assert_eq!(tree["render"]["samples"], 16);
        let (tree, _) = edited(text, "render.view=bank");
        assert_eq!(tree["render"]["view"], "bank");
        let (tree, _) = edited(text, "sky.sun_azimuth_deg=-12.5");
        assert_eq!(tree["sky"]["sun_azimuth_deg"], -12.5);
        let (tree, _) = edited(text, "render.resolution=[32, 18]");
        assert_eq!(tree["render"]["resolution"], serde_json::json!([32, 18]));
    }

    #[test]
    fn a_mistake_in_the_flag_is_shown_in_the_flag() {
        let text = "seed = 1\nstep = [1, 2]";
        let told = |flag| edited(text, flag).1.join("");
        assert_eq!(
            told("seed"),
            "seed: no `=` in what is to be set; write for instance `--set render.samples=16`"
        );
        assert_eq!(told("step[7]=1"), "7: there is no place 7; the array has 2, counted from 0");
        assert_eq!(told("seed.x=1"), "x: `x` is looked for in 1, which is no table");
        assert!(told("a..b=1").contains("an empty name"));
        assert!(told("a[x]=1").contains("is no place"));
        assert!(told("a=[1, 2").starts_with(|_: char| true));
        assert!(!told("a=[1, 2").is_empty());
    }

    proptest::proptest! {
        #[test]
        fn no_flag_makes_it_panic(flag in "\\PC{0,40}") {
            let mut sources = Sources::default();
            let mut root = Value::parse(0, "a = [1, {b = 2}]\n[c]\nd = 1").unwrap();
            set(&mut root, &flag, &mut sources, &mut Vec::new());
        }
    }
}
