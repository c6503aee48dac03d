// What frames the map: graticule with labels, scale bar, names of images; texts avoid each other and the edges.

import {label, roundBelow, trace} from './plot.js';

const MOST_NAMED = 40; // images in the window of which names are shown
const HIGH = 15; // CSS pixels of a text

export class MapFrame {
  constructor(map) {
    Object.assign(this, {map, names: null, unnamed: 0});
  }

  // pen: {context, x, y: m to pixels, width, height, ink, paper}
  draw(pen) {
    const {shown, layers, outlines, hover} = this.map;
    this.taken = [];
    this.drawScaleBar(pen);
    if (shown.graticule) for (const line of layers.graticule?.lines || []) this.drawLine(pen, line);
    if (!shown.footprints || !outlines) return;
    this.names ||= this.placeNames(pen);
    for (const [name, [east, north]] of this.names) write(pen, name, pen.x(east) + 4, pen.y(north) - 4);
    const here = hover ? this.map.app.scene.images.filter((_, k) => contains(outlines[k], hover)).map(one => one.name) : [];
    const words = here.slice(0, 3).join(', ') + (here.length > 3 ? ` and ${here.length - 3} more` : ''), wide = pen.context.measureText(words).width;
    if (words) write(pen, words, Math.min(pen.x(hover[0]) + 14, pen.width - wide - 4), Math.min(pen.y(hover[1]) + 22, pen.height - 4));
  }

  // Whether a text has room in the window, beside those that are there; it has it then
  hasRoom({width, height}, left, top, wide) {
    const right = left + wide, bottom = top + HIGH;
    if (left < 2 || top < 2 || right > width - 2 || bottom > height - 2
      || this.taken.some(one => left < one[2] && right > one[0] && top < one[3] && bottom > one[1])) return false;
    this.taken.push([left, top, right, bottom]);
    return true;
  }

  drawScaleBar(pen) {
    const {context, width, height, ink, paper} = pen, {scale} = this.map.view;
    const length = roundBelow(140 / scale), right = 10 + length * scale, low = height - 9;
    this.taken.push([0, height - 32, right + 60, height], [width - 40, 0, width, 24]);
    for (const [strokeStyle, lineWidth] of [[paper, 5], [ink, 2]]) {
      Object.assign(context, {strokeStyle, lineWidth});
      trace(context, [[10, low - 6], [10, low], [right, low], [right, low - 6]]);
    }
    write(pen, length >= 1000 ? `${length / 1000} km` : `${length} m`, 16, low - 5);
    write(pen, 'N ↑', width - 30, 18);
  }

  // A meridian or parallel, its label where it crosses the edge of the window
  drawLine(pen, {label: name, places}) {
    const {context, x, y, width, height} = pen, wide = context.measureText(name).width, edge = ([a, b]) => a < 0 || a > width || b < 0 || b > height;
    const line = places.map(([east, north]) => [x(east), y(north)]);
    Object.assign(context, {strokeStyle: 'rgba(128, 128, 128, 0.6)', lineWidth: 1});
    trace(context, line);
    const corner = ([a, b]) => [Math.max(3, Math.min(a + 3, width - wide - 3)), Math.max(3, Math.min(b - 16, height - 18))];
    const fits = line.find((one, k) => k && edge(one) !== edge(line[k - 1]) && this.hasRoom(pen, ...corner(one), wide));
    if (fits) write(pen, name, corner(fits)[0], corner(fits)[1] + 12);
  }

  // Names of images and where they stand: to the right of their outlines, the image on top first
  placeNames(pen) {
    const {outlines, app, top} = this.map, [x0, y0, x1, y1] = this.map.box(), found = [];
    const images = app.scene.images.map(({name}, k) => ({name, outline: [...outlines[k]].sort((one, other) => other[0] - one[0])}));
    const seen = images.filter(one => one.outline.some(([a, b]) => a > x0 && a < x1 && b > y0 && b < y1));
    seen.sort((one, other) => (other.name === top.value) - (one.name === top.value));
    for (const {name, outline} of seen.slice(0, seen.length > MOST_NAMED ? Number(Boolean(top.value)) : MOST_NAMED)) {
      const wide = pen.context.measureText(name).width, place = outline.find(([a, b]) => this.hasRoom(pen, pen.x(a) + 4, pen.y(b) - 16, wide));
      if (place) found.push([name, place]);
    }
    this.unnamed = seen.length - found.length;
    return found;
  }
}

// A text in the colors of the page
export const write = ({context, ink, paper}, words, left, base) => label(context, words, left, base, ink, paper);

// Whether an outline runs around a place: the sides to its right are odd in number
function contains(outline, [x, y]) {
  return outline.filter(([x1, y1], k) => {
    const [x0, y0] = outline.at(k - 1);
    return (y0 > y) !== (y1 > y) && x < x0 + (y - y0) * (x1 - x0) / (y1 - y0);
  }).length % 2 === 1;
}
