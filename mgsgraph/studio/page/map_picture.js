// What the map shows, drawn on a canvas: outlines, points one by one or in cells, vectors, ellipses, and the legend.

import {caption, make, palette, roundBelow, short, trace} from './plot.js';

const SIGNED = ['moved_up'];
const ELLIPSE = Math.sqrt(5.991); // 95 % of two dimensions
const MARKS = ['tie', 'laser', 'control', 'post'];
const SHAPES = {laser: [[0, -1], [1, 1], [-1, 1]], control: [[-1, -1], [1, -1], [1, 1], [-1, 1]], post: [[0, -1], [1, 0], [0, 1], [-1, 0]]};

export class MapPicture {
  constructor(map) {
    Object.assign(this, {map, factors: {}});
  }

  // All layers that are shown, from below upwards; pen: {context, x, y: m to pixels, width, height, ink, moved, strong}
  draw(pen) {
    const {shown, layers, app, outlines} = this.map, {points} = layers, single = points?.form === 'points';
    if (shown.sigmas && layers.sigmas) this.drawSigmas(pen, layers.sigmas);
    if (shown.footprints && outlines) this.drawOutlines(pen, outlines);
    if (shown.points && points) single ? this.drawMarks(pen, points) : this.drawCells(pen, points);
    if (shown.ellipses && single) this.drawEllipses(pen, points);
    if (shown.moved && points) {
      const places = points.places || points.x.map((one, k) => [one, points.y[k]]), [east, north] = points.moved;
      this.factors.moved = this.arrows({...pen, ink: pen.strong}, places, east.map((one, k) => [one, north[k]]));
    }
    if (shown.residuals && layers.residuals) this.factors.residuals = this.arrows(pen, layers.residuals.places, layers.residuals.vectors, 30);
    if (shown.changes && app.last?.moved) this.drawChange({...pen, ink: pen.moved}, app.last.moved.filter(one => one.map_m));
    if (shown.candidates) this.drawCandidates(pen, app.candidates.filter(one => one.map_m));
    this.drawSelection(pen);
  }

  drawSigmas({context, x, y}, layer) {
    const {color} = this.scale(layer);
    context.globalAlpha = 0.75;
    layer.corners.forEach((one, k) => {
      context.fillStyle = color(layer.values[k]);
      context.beginPath();
      for (let c = 0; c < 8; c += 2) context.lineTo(x(one[c]), y(one[c + 1]));
      context.fill();
    });
    context.globalAlpha = 1;
  }

  drawOutlines({context, x, y, ink, paper}, outlines) {
    for (const [strokeStyle, lineWidth] of this.map.shown.images ? [[paper, 2.5], [ink, 1]] : [[ink, 1]]) {
      Object.assign(context, {strokeStyle, lineWidth});
      for (const outline of outlines) trace(context, outline.map(([east, north]) => [x(east), y(north)]));
    }
  }

  // Ends of the color scale, and the color of a value
  scale({value, low, high} = this.map.layers.points) {
    const signed = SIGNED.includes(value), most = Math.max(Math.abs(low), Math.abs(high)), colors = palette(signed);
    const [first, last] = signed ? [-most, most] : [low, high];
    const step = one => Math.min(Math.max(Math.floor(64 * (one - first) / (last - first || 1)), 0), 63);
    return {first, last, colors, color: one => (one === null ? '#888' : colors[step(one)])};
  }

  drawCells({context, x, y}, {columns, rows, box, cells, values}) {
    const {color} = this.scale(), wide = (x(box[2]) - x(box[0])) / columns, high = (y(box[1]) - y(box[3])) / rows;
    cells.forEach((cell, k) => {
      context.fillStyle = color(values[k]);
      context.fillRect(x(box[0]) + (cell % columns) * wide, y(box[1]) - (Math.floor(cell / columns) + 1) * high, Math.max(wide, 1), Math.max(high, 1));
    });
  }

  drawMarks({context, x, y, ink}, {x: east, y: north, values, classes}) {
    const {color} = this.scale(), size = east.length > 1500 ? 2 : 3.5;
    Object.assign(context, {strokeStyle: ink, lineWidth: 0.5});
    east.forEach((one, k) => {
      const shape = SHAPES[MARKS[classes[k]]];
      context.fillStyle = color(values[k]);
      context.beginPath();
      if (shape) for (const [right, down] of shape) context.lineTo(x(one) + size * right, y(north[k]) + size * down);
      else context.arc(x(one), y(north[k]), size, 0, 2 * Math.PI);
      context.closePath();
      context.fill();
      if (size > 3) context.stroke();
    });
  }

  enlarged(lengths, share, most) {
    const sorted = lengths.filter(Number.isFinite).sort((a, b) => a - b), wanted = Number(this.map.factor.value);
    const longest = sorted[Math.min(sorted.length - 1, Math.floor(share * sorted.length))];
    return wanted > 0 ? wanted : longest > 0 ? roundBelow(most / (longest * this.map.view.scale)) : 1;
  }

  drawEllipses({context, x, y, strong}, {x: east, y: north, covariance: [ee, en, nn]}) {
    const factor = this.factors.ellipses = this.enlarged(ee.map((one, k) => ELLIPSE * Math.sqrt(Math.max(one, nn[k]))), 0.9, 25);
    const axis = square => Math.max(factor * ELLIPSE * this.map.view.scale * Math.sqrt(Math.max(square, 0)), 0.5);
    Object.assign(context, {strokeStyle: strong, lineWidth: 1});
    east.forEach((one, k) => {
      if (ee[k] === null) return;
      const middle = (ee[k] + nn[k]) / 2, half = Math.hypot((ee[k] - nn[k]) / 2, en[k]), turn = 0.5 * Math.atan2(2 * en[k], ee[k] - nn[k]);
      context.beginPath();
      context.ellipse(x(one), y(north[k]), axis(middle + half), axis(middle - half), -turn, 0, 2 * Math.PI);
      context.stroke();
    });
  }

  // Returns by how much the vectors are enlarged
  arrows({context, x, y, ink}, places, vectors, most = 45) {
    const factor = this.enlarged(vectors.map(one => Math.hypot(...one)), 0.95, most), scale = factor * this.map.view.scale;
    Object.assign(context, {strokeStyle: ink, lineWidth: 1.2});
    vectors.forEach(([east, north], k) => {
      if (east === null || north === null) return;
      const from = [x(places[k][0]), y(places[k][1])], to = [from[0] + east * scale, from[1] - north * scale];
      const angle = Math.atan2(-north, east), head = Math.min(6, 0.4 * Math.hypot(east, north) * scale);
      const side = turn => [to[0] - head * Math.cos(angle + turn), to[1] - head * Math.sin(angle + turn)];
      trace(context, [from, to, side(-0.5), to, side(0.5)]);
    });
    return factor;
  }

  drawChange(pen, moved) {
    this.ring(pen, moved.filter(one => one.sigmas === null).map(one => one.map_m), 5, 2);
    const known = moved.filter(one => one.vector_m);
    this.factors.changes = this.arrows(pen, known.map(one => one.map_m), known.map(one => one.vector_m), 60);
  }

  drawCandidates({context, x, y, moved}, candidates) {
    Object.assign(context, {strokeStyle: moved, fillStyle: moved, lineWidth: 2});
    candidates.forEach(({map_m: [east, north]}, k) => {
      context.strokeRect(x(east) - 7, y(north) - 7, 14, 14);
      context.fillText(String(k + 1), x(east) + 9, y(north) + 4);
    });
  }

  drawSelection(pen) {
    const at = this.map.placeOf(this.map.app.selection);
    this.ring(pen, this.map.selection.found?.places || [], 6, 2);
    this.ring(pen, at ? [at] : [], 9, 3);
  }

  ring({context, x, y, moved}, places, radius, lineWidth) {
    Object.assign(context, {strokeStyle: moved, lineWidth});
    for (const [east, north] of places) {
      context.beginPath();
      context.arc(x(east), y(north), radius, 0, 2 * Math.PI);
      context.stroke();
    }
  }

  // What the colors, marks and lengths mean
  legend() {
    const {shown, layers: {points, residuals, sigmas}, app} = this.map, {factors} = this;
    if (!points) return [];
    const {first, last, colors} = this.scale(), bar = make('div', {className: 'legend-bar', style: `background: linear-gradient(to right, ${colors})`});
    const enlarged = [
      shown.ellipses && points.form === 'points' && `ellipses × ${short(factors.ellipses)}`, shown.moved && `corrections × ${short(factors.moved)}`,
      shown.residuals && residuals && `residuals of ${residuals.image} on the ground × ${short(factors.residuals)}, median ${short(residuals.median_px)} px`,
      shown.changes && app.last?.moved && `last change × ${short(factors.changes)}`, shown.sigmas && sigmas && `cells: ${sigmas.sentence}`,
    ].filter(Boolean).join('; ');
    return [
      make('strong', {textContent: `${points.title} (${points.unit})`}), bar,
      make('div', {className: 'legend-ends'}, make('span', {textContent: short(first)}), make('span', {textContent: short(last)})),
      caption(`${points.count} points in and around the window${points.form === 'cells' ? ', medians of cells' : ''}; colors end at the 98 % quantile of the block. `
        + `Marks: ● tie, ▲ laser, ■ control, ◆ post of a terrain model.${enlarged && ` ${enlarged}.`}`),
    ];
  }
}
