//! The engine `example` as a worker of bodycheck: replace `advance`, and what it needs, by your engine.
//! A request is searched for its keys instead of parsed: they are unique in a scene without loads and link.
use std::io::{BufRead, Write};

type Vector = [f64; 3];

#[derive(Clone)]
struct State { position: Vector, velocity: Vector, quaternion: [f64; 4], omega: Vector } // omega in body axes

struct Case { mass: f64, inertia: [f64; 9], gravity: Vector, dt_s: f64, samples: f64, stride: f64, start: State }

fn numbers<const N: usize>(line: &str, key: &str) -> Result<[f64; N], String> {
    let text = line.split_once(&format!("\"{key}\":")).ok_or(format!("no {key}"))?.1;
    let words = text.split([',', '[', ']', '}', ' ']).filter(|word| !word.is_empty());
    let found: Vec<f64> = words.map_while(|word| word.parse().ok()).take(N).collect();
    found.try_into().map_err(|_| format!("{key}: not {N} numbers"))
}

fn case_of(line: &str) -> Result<Case, String> {
    if !line.contains("\"method\":\"euler\"") { return Err("only the method euler".into()); }
    if !line.contains("\"loads\":[]") || line.contains("\"pivot\":") || line.contains("\"link\":") {
        return Err("only gravity: no loads, pivot or link frame".into());
    }
    let ([duration_s], [samples]) = (numbers(line, "duration_s")?, numbers(line, "samples")?);
    let ([mass], [dt_s]) = (numbers(line, "mass")?, numbers(line, "dt_s")?);
    let (inertia, gravity) = (numbers(line, "inertia")?, numbers(line, "gravity")?);
    let (position, velocity) = (numbers(line, "position")?, numbers(line, "velocity")?);
    let (quaternion, omega) = (numbers(line, "quaternion")?, numbers(line, "omega_body")?);
    let stride = (duration_s / (samples - 1.0) / dt_s).round(); // steps from one sample to the next
    let (dt_s, start) = (duration_s / (stride * (samples - 1.0)), State { position, velocity, quaternion, omega });
    Ok(Case { mass, inertia, gravity, dt_s, samples, stride, start })
}

fn cross(a: Vector, b: Vector) -> Vector {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

fn dot(a: Vector, b: Vector) -> f64 {
    (0..3).map(|i| a[i] * b[i]).sum()
}

/// The engine, explicit Euler: omega += h I^-1 (-omega x I omega); q += h/2 q omega; x += h v; v += h g.
fn advance(case: &Case, s: &mut State) {
    let (h, i) = (case.dt_s, case.inertia);
    let rows @ [a, b, c] = [[i[0], i[1], i[2]], [i[3], i[4], i[5]], [i[6], i[7], i[8]]];
    let torque = cross(rows.map(|row| dot(row, s.omega)), s.omega);
    let ([w, x, y, z], [p, q, r]) = (s.quaternion, s.omega);
    let rate = [-x * p - y * q - z * r, w * p + y * r - z * q, w * q + z * p - x * r, w * r + x * q - y * p];
    s.quaternion.iter_mut().zip(rate).for_each(|(value, rate)| *value += 0.5 * h * rate);
    for (k, minors) in [cross(b, c), cross(c, a), cross(a, b)].into_iter().enumerate() {
        s.omega[k] += h * dot(minors, torque) / dot(a, cross(b, c)); // Cramer's rule
        s.position[k] += h * s.velocity[k];
        s.velocity[k] += h * case.gravity[k];
    }
}

/// Make all steps from the start; return the state at each sample.
fn run(case: &Case) -> Vec<State> {
    let mut path = vec![case.start.clone()];
    while (path.len() as f64) < case.samples {
        path.push(path[path.len() - 1].clone());
        (0..case.stride as u64).for_each(|_| advance(case, path.last_mut().unwrap()));
    }
    path
}

fn list(numbers: &[f64]) -> String {
    let word = |x: &f64| if x.is_finite() { format!("{x:?}") } else { "null".into() };
    format!("[{}]", numbers.iter().map(word).collect::<Vec<_>>().join(","))
}

fn text(s: &State) -> String {
    let [x, v, q, w] = [list(&s.position), list(&s.velocity), list(&s.quaternion), list(&s.omega)];
    format!(r#"{{"position":{x},"velocity":{v},"quaternion":{q},"omega_body":{w}}}"#)
}

fn answer(line: &str, prepared: &mut Option<Case>) -> Result<String, String> {
    extern "C" { fn clock() -> std::ffi::c_long; } // CPU time in us, by POSIX
    let asked = |request: &str| line.contains(&format!("\"do\":\"{request}\""));
    if asked("prepare") { *prepared = Some(case_of(line)?); }
    if asked("prepare") || asked("lap") {
        let begin = unsafe { clock() };
        std::hint::black_box(run(prepared.as_ref().ok_or("nothing is prepared")?));
        return Ok(format!(r#""outcome":"ok","cpu_s":{:?}"#, 1e-6 * unsafe { clock() - begin } as f64));
    }
    if asked("stable-step") { return Err("no search for the largest stable step".into()); }
    if !asked("record") && !asked("replay") {
        return Ok(r#""outcome":"failed","message":"no such request""#.into());
    }
    let case = case_of(line)?;
    let state = text(&if asked("replay") { run(&case).pop().unwrap() } else { case.start.clone() });
    let path = run(&case).iter().map(text).collect::<Vec<_>>().join(",");
    let inertia = case.inertia.chunks(3).map(list).collect::<Vec<_>>().join(",");
    let (mass, dt_s, gravity) = (case.mass, case.dt_s, list(&case.gravity));
    let held = format!(r#""mass":{mass:?},"dt_s":{dt_s:?},"gravity":{gravity},"state":{state},"inertia":[{inertia}]"#);
    Ok(format!(r#""outcome":"ok","trajectory":[{path}],"read_back":{{{held}}}"#))
}

fn main() -> std::io::Result<()> {
    let (mut prepared, mut out) = (None, std::io::stdout());
    let facts = "{'bodycheck':1,'engine':'example','version':'0.1.0','limits':{'message_bytes':1048576},\
        'methods':[{'name':'euler','formula':'explicit Euler','order':1,'evaluations':1,\
        'torque':'zero-order hold','conserves':'nothing','source':'its manual'}]}";
    writeln!(out, "{}", facts.replace('\'', "\""))?;
    for line in std::io::stdin().lock().lines() {
        let line = line?;
        let id = numbers::<1>(&line, "id").map_or("null".into(), |[id]| id.to_string());
        match answer(&line, &mut prepared) {
            Ok(answer) => writeln!(out, r#"{{"id":{id},{answer}}}"#)?,
            Err(why) => writeln!(out, r#"{{"id":{id},"outcome":"unsupported","message":"{why}"}}"#)?,
        }
        out.flush()?;
    }
    Ok(())
}
