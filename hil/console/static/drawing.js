// The machine as its file has it, seen along its two horizontal directions: lines from body to body, their masses as discs.
const SVG = "http://www.w3.org/2000/svg";
const VIEWS = [{ name: "front", across: 1 }, { name: "side", across: 0 }];
const UP = 2;
const EDGE_m = 0.15;
const DISC_m = 0.014; // radius of a disc of 1 kg; others by the cube root of their mass

const times = (matrix, vector) => matrix.map((row) => row.reduce((sum, value, k) => sum + value * vector[k], 0));
const product = (a, b) => a.map((row) => b[0].map((_, column) => row.reduce((sum, value, k) => sum + value * b[k][column], 0)));
const plus = (a, b) => a.map((value, k) => value + b[k]);

// Rodrigues: cos I + (1 - cos) a a' + sin [a]x
function rotation([x, y, z], angle) {
  const [c, s] = [Math.cos(angle), Math.sin(angle)];
  const across = [[0, -z, y], [z, 0, -x], [-y, x, 0]];
  const axis = [x, y, z];
  return across.map((row, i) => row.map((value, j) => (i === j ? c : 0) + (1 - c) * axis[i] * axis[j] + s * value));
}

// Of every body its parent's origin, its own, and its centre of mass in the world [m], from the axes' positions [rad or m].
export function places(bodies, positions) {
  const frames = { world: { at: [0, 0, 0], turned: [[1, 0, 0], [0, 1, 0], [0, 0, 1]] } };
  return bodies.map((body) => {
    const parent = frames[body.parent];
    let at = plus(parent.at, times(parent.turned, body.position_m));
    let turned = product(parent.turned, body.orientation);
    const moved = positions[body.axis] ?? body.rest;
    if (body.kind === "revolute") turned = product(turned, rotation(body.along, moved));
    if (body.kind === "prismatic") at = plus(at, times(turned, body.along.map((value) => value * moved)));
    frames[body.name] = { at, turned };
    return { from: body.parent === "world" ? at : parent.at, at, mass: plus(at, times(turned, body.center_of_mass_m)) };
  });
}

function drawn(name, attributes, ...children) {
  const made = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  made.append(...children);
  return made;
}

// Returns the pictures (name, svg), and what moves them: it takes the axes' positions [rad or m] by name.
export function draw(bodies, axes) {
  const reached = axes.flatMap((axis) => [axis.lower, 0, axis.upper].map((value) => places(bodies, { [axis.name]: value }))).flat();
  const pictures = VIEWS.map(({ name, across }) => {
    const spot = (point) => [point[across], -point[UP]];
    const spots = reached.flatMap(({ at, mass }) => [spot(at), spot(mass)]);
    const [left, top] = [0, 1].map((k) => Math.min(...spots.map((each) => each[k])) - EDGE_m);
    const [right, bottom] = [0, 1].map((k) => Math.max(...spots.map((each) => each[k])) + EDGE_m);
    const parts = bodies.map((body) => ({
      link: drawn("line", { class: "link" }),
      arm: drawn("line", { class: "arm" }),
      disc: drawn("circle", { r: DISC_m * Math.cbrt(body.mass_kg), "data-body": body.name }, drawn("title", {}, body.name)),
    }));
    const lines = parts.flatMap(({ link, arm }) => [link, arm]);
    const box = { viewBox: `${left} ${top} ${right - left} ${bottom - top}`, role: "img", "aria-label": `the machine, ${name}` };
    return { name, spot, parts, svg: drawn("svg", box, ...lines, ...parts.map(({ disc }) => disc)) };
  });
  const move = (positions) => {
    const found = places(bodies, positions);
    for (const { spot, parts } of pictures) {
      for (const [k, { link, arm, disc }] of parts.entries()) {
        const [from, at, mass] = [found[k].from, found[k].at, found[k].mass].map(spot);
        for (const [line, begins, ends] of [[link, from, at], [arm, at, mass]]) {
          for (const [key, value] of Object.entries({ x1: begins[0], y1: begins[1], x2: ends[0], y2: ends[1] })) line.setAttribute(key, value);
        }
        disc.setAttribute("cx", mass[0]);
        disc.setAttribute("cy", mass[1]);
      }
    }
  };
  return { pictures, move };
}
