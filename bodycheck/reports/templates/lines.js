// Lines that cannot be distinguished are drawn as one; labels stand at their ends.
const ALIKE = 2e-3; // lines are equal if they differ by less, relative to their values
const LABEL_PX = 13; // height of a name at the end of a line

function alike(a, b, floor) {
  return a.x.length === b.x.length && a.x.every((x, k) => {
    const [p, q] = [a.y[k], b.y[k]];
    return x === b.x[k] && (Math.abs(p - q) <= ALIKE * Math.max(p, q) || Math.max(p, q) <= floor);
  });
}

// Groups of equal lines {m, x, y}: the first of each, with the methods of all.
function merged(lines, floor = 0) {
  const groups = [];
  for (const line of lines) {
    const group = groups.find(own => own.level === line.level && alike(own, line, floor));
    if (group) group.members.push(line.m);
    else groups.push({ ...line, members: [line.m] });
  }
  return groups;
}

const fullName = group => group.members.map(m => methods[m].name).join(" = ");

// The traces of a merged line: one for each engine, the lower ones wider, so that all colours are seen.
function tracesOf(group, more) {
  const first = group.members.filter((m, k, all) => all.findIndex(n => methods[n].engine === methods[m].engine) === k);
  return first.map((m, k) => ({
    ...look(m, group.level, first.length - 1 - k, first.length > 1),
    meta: m,
    mode: group.level === "grey" ? "lines" : "lines+markers",
    x: group.x, y: group.y, ...more,
    hoverinfo: k === first.length - 1 ? "text" : "skip",
    name: plain(fullName(group)),
  }));
}

// The traces of all lines: grey ones at the bottom, then the wide ones below the thin ones.
function stacked(groups, more) {
  const of = level => groups.filter(group => group.level === level).flatMap(group => tracesOf(group, more(group)));
  return [...of("grey"), ...of("on").sort((a, b) => b.line.width - a.line.width || a.meta - b.meta)];
}

// The names of a merged line, one below the other; of many, the first ones.
function labelOf({ members }, most) {
  const shown = members.length > most ? members.slice(0, most - 1) : members;
  const names = shown.map((m, k) => ({ text: `${k ? "= " : ""}${methods[m].name}`, m }));
  return shown.length < members.length ? [...names, { text: `= ${members.length - shown.length} more`, m: members[0] }] : names;
}

// Labels at the right ends of the selected lines, moved apart where they would overlap.
function endLabels(plot, groups) {
  const { yaxis, xaxis } = plot._fullLayout;
  const selected = groups.filter(group => group.level === "on" && group.y.length);
  const room = Math.floor(yaxis._length / LABEL_PX);
  const names = selected.reduce((sum, group) => sum + group.members.length, 0);
  const most = names > room ? 2 : Infinity;
  const ends = selected.map(group => {
    const last = group.x.reduce((best, x, k) => (xaxis.d2p(x) > xaxis.d2p(group.x[best]) ? k : best), 0);
    const label = labelOf(group, most);
    return { group, label, y: group.y[last], at: yaxis.d2p(group.y[last]), height: label.length * LABEL_PX };
  }).sort((a, b) => a.at - b.at);
  let least = -LABEL_PX / 2;
  for (const end of ends) {
    end.top = Math.max(end.at - LABEL_PX / 2, least);
    least = end.top + end.height;
  }
  let lowest = yaxis._length + LABEL_PX;
  for (const end of ends.toReversed()) {
    end.top = Math.min(end.top, lowest - end.height);
    lowest = end.top;
  }
  return ends.flatMap(({ group, label, y, at, top }) => label.map(({ text, m }, k) => ({
    xref: "paper", x: 1, xanchor: "left", xshift: 6, yref: "y", y: Math.log10(y), yanchor: "middle",
    yshift: at - (top + (k + 0.5) * LABEL_PX), showarrow: false, text: plain(text), hovertext: plain(fullName(group)),
    font: { size: 11, color: engineColour(m) },
  })));
}
