/* The attitude in 3D: the board at its lever arm from the reference point, the axes l, s, t, the horizon with north,
 * and gravity. A projection of our own on a canvas. */
import {apply, norm, plus, times} from "./rotation.js";

const BOARD = [0.52, 0.36, 0.05]; /* half of its size along l, s, t; the picture has no scale */
const ARM = 0.9; /* length of the lever arm in the picture */
const AXIS = 1.15;
const DISTANCE = 7; /* of the eye */
const RADIUS = 1.3; /* of the horizon */

const FACES = [
  [0, 1, 2],
  [0, -1, 2],
  [1, 1, 2],
  [1, -1, 2],
  [2, 1, 1],
  [2, -1, 1],
].map(([axis, sign]) => {
  const [u, v] = [0, 1, 2].filter((i) => i !== axis);
  const corner = (a, b) => {
    const p = [0, 0, 0];
    p[axis] = sign;
    p[u] = a;
    p[v] = b;
    return p;
  };
  return {axis, sign, corners: [corner(-1, -1), corner(1, -1), corner(1, 1), corner(-1, 1)]};
});

export class AttitudeView {
  /** colours: {text, muted, grid, board, edge, axes: [l, s, t], arm} */
  constructor(canvas, words) {
    this.canvas = canvas;
    this.words = words;
    this.azimuth = -115; /* the eye stands south-south-west and looks north */
    this.elevation = 24;
    this.r = null;
    this.arm_m = [0, 0, 0];
    this.stale = true;
    let from = null;
    canvas.addEventListener("pointerdown", (event) => {
      from = [event.clientX, event.clientY];
      canvas.setPointerCapture(event.pointerId);
    });
    canvas.addEventListener("pointermove", (event) => {
      if (!from) return;
      this.turn(-0.5 * (event.clientX - from[0]), 0.5 * (event.clientY - from[1]));
      from = [event.clientX, event.clientY];
    });
    canvas.addEventListener("pointerup", () => (from = null));
    canvas.addEventListener("pointercancel", () => (from = null));
    canvas.addEventListener("keydown", (event) => {
      const step = {ArrowLeft: [-5, 0], ArrowRight: [5, 0], ArrowUp: [0, 5], ArrowDown: [0, -5]}[event.key];
      if (!step) return;
      event.preventDefault();
      this.turn(...step);
    });
  }

  turn(azimuth, elevation) {
    this.azimuth += azimuth;
    this.elevation = Math.min(89, Math.max(-20, this.elevation + elevation));
    this.draw();
  }

  /** To the picture: [x, y, depth]. */
  project(p) {
    const a = (this.azimuth * Math.PI) / 180,
      e = (this.elevation * Math.PI) / 180;
    const out = [Math.cos(a) * Math.cos(e), Math.sin(a) * Math.cos(e), Math.sin(e)]; /* towards the eye */
    const right = [-Math.sin(a), Math.cos(a), 0];
    const up = [-Math.cos(a) * Math.sin(e), -Math.sin(a) * Math.sin(e), Math.cos(e)];
    const along = (v) => p[0] * v[0] + p[1] * v[1] + p[2] * v[2];
    const k = (this.scale * DISTANCE) / (DISTANCE - along(out));
    return [this.centre[0] + k * along(right), this.centre[1] - k * along(up), along(out)];
  }

  line(points, colour, width, dash = []) {
    const c = this.context;
    c.strokeStyle = colour;
    c.lineWidth = width;
    c.setLineDash(dash);
    c.beginPath();
    points.map((p) => this.project(p)).forEach(([x, y], i) => (i ? c.lineTo(x, y) : c.moveTo(x, y)));
    c.stroke();
    c.setLineDash([]);
  }

  arrow(from, to, colour, width, name) {
    const c = this.context,
      [x0, y0] = this.project(from),
      [x, y] = this.project(to);
    const length = Math.hypot(x - x0, y - y0);
    this.line([from, to], colour, width);
    if (length > 8) {
      const [u, v] = [(x - x0) / length, (y - y0) / length];
      c.fillStyle = colour;
      c.beginPath();
      c.moveTo(x + 5 * u, y + 5 * v);
      c.lineTo(x - 5 * u + 4 * v, y - 5 * v - 4 * u);
      c.lineTo(x - 5 * u - 4 * v, y - 5 * v + 4 * u);
      c.fill();
      this.text(name, x + 14 * u, y + 14 * v, colour);
    } else {
      this.text(name, x + 10, y - 10, colour);
    }
  }

  text(text, x, y, colour) {
    const c = this.context;
    c.strokeStyle = this.colours.surface; /* a rim, so that it can be read on anything */
    c.lineWidth = 3;
    c.lineJoin = "round";
    c.strokeText(text, x, y);
    c.fillStyle = colour;
    c.fillText(text, x, y);
  }

  horizon(colours) {
    const circle = (radius) =>
      Array.from({length: 49}, (_, i) => [
        radius * Math.cos((i * Math.PI) / 24),
        radius * Math.sin((i * Math.PI) / 24),
        0,
      ]);
    for (const radius of [RADIUS / 3, (2 * RADIUS) / 3, RADIUS]) this.line(circle(radius), colours.grid, 1);
    this.line(
      [
        [-RADIUS, 0, 0],
        [RADIUS, 0, 0],
      ],
      colours.grid,
      1
    );
    this.line(
      [
        [0, -RADIUS, 0],
        [0, RADIUS, 0],
      ],
      colours.grid,
      1
    );
    const mark = (text, p) => {
      const [x, y] = this.project(p);
      this.text(text, x, y, colours.muted);
    };
    this.arrow([0, 0, 0], [0, RADIUS, 0], colours.muted, 1.5, this.words.north);
    mark(this.words.east, [RADIUS * 1.1, 0, 0]);
    mark(this.words.south, [0, -RADIUS * 1.1, 0]);
    mark(this.words.west, [-RADIUS * 1.1, 0, 0]);
  }

  board(centre, colours) {
    const c = this.context;
    const place = (corner) =>
      plus(
        centre,
        apply(
          this.r,
          corner.map((v, i) => v * BOARD[i])
        )
      );
    const faces = FACES.map((face) => {
      const corners = face.corners.map((p) => this.project(place(p)));
      return {...face, corners, depth: corners.reduce((sum, p) => sum + p[2], 0)};
    });
    for (const {axis, sign, corners} of faces.sort((a, b) => a.depth - b.depth)) {
      c.beginPath();
      corners.forEach(([x, y], i) => (i ? c.lineTo(x, y) : c.moveTo(x, y)));
      c.closePath();
      c.fillStyle = axis === 2 ? (sign > 0 ? colours.board : colours.under) : colours.edge;
      c.fill();
      c.strokeStyle = colours.outline;
      c.lineWidth = 1;
      c.stroke();
      if (axis !== 2 || sign < 0) continue;
      /* the chip, and a row of pads at the rear, so that front and rear differ */
      const flat = (l, s) => this.project(place([l, s, 1]));
      const patch = (l, s, a, b, colour) => {
        c.fillStyle = colour;
        c.beginPath();
        for (const [x, y] of [flat(l - a, s - b), flat(l + a, s - b), flat(l + a, s + b), flat(l - a, s + b)])
          c.lineTo(x, y);
        c.fill();
      };
      patch(0, 0, 0.2, 0.28, colours.chip);
      for (let i = -3; i <= 3; i++) patch(-0.84, i * 0.24, 0.05, 0.07, colours.pad);
    }
  }

  draw() {
    const colours = this.colours,
      canvas = this.canvas,
      c = (this.context = canvas.getContext("2d"));
    const ratio = window.devicePixelRatio || 1,
      width = canvas.clientWidth,
      height = canvas.clientHeight;
    if (!colours || !width || !height) return;
    if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
      canvas.width = Math.round(width * ratio);
      canvas.height = Math.round(height * ratio);
    }
    c.setTransform(ratio, 0, 0, ratio, 0, 0);
    c.clearRect(0, 0, width, height);
    c.font = "600 12px system-ui, sans-serif";
    c.textAlign = "center";
    c.textBaseline = "middle";
    c.globalAlpha = this.stale ? 0.45 : 1;
    this.scale = Math.min(width / 3.35, height / 2.9);
    this.centre = [width / 2, height * 0.52];
    this.horizon(colours);
    if (!this.r) return;
    const length_m = norm(this.arm_m);
    const sensor = length_m > 0 ? apply(this.r, times(ARM / length_m, this.arm_m)) : [0, 0, 0];
    /* what is behind the board is drawn first */
    const axes = [0, 1, 2]
      .map((i) => {
        const to = apply(
          this.r,
          [0, 1, 2].map((k) => (k === i ? AXIS : 0))
        );
        return {to, depth: this.project(to)[2], colour: colours.axes[i], name: "lst"[i]};
      })
      .sort((a, b) => a.depth - b.depth);
    const depth = this.project(sensor)[2];
    const show = (axis) => this.arrow([0, 0, 0], axis.to, axis.colour, 2.5, axis.name);
    const behind = axes.filter((axis) => axis.depth < depth);
    behind.forEach(show);
    this.arrow(sensor, plus(sensor, [0, 0, -0.95]), colours.muted, 1.5, "g");
    this.board(sensor, colours);
    axes.filter((axis) => !behind.includes(axis)).forEach(show);
    if (length_m > 0) this.line([[0, 0, 0], sensor], colours.arm, 2.5, [5, 4]);
    const [x, y] = this.project([0, 0, 0]);
    c.fillStyle = colours.arm;
    c.beginPath();
    c.arc(x, y, 4, 0, 2 * Math.PI);
    c.fill();
    if (length_m > 0) this.text(this.words.arm(length_m), x, y + 16, colours.arm);
  }
}
