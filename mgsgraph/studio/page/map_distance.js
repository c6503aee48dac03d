// Distances on the map: two clicks, or Enter for the middle of the window; points have sigmas, free places have none.

import {write} from './map_frame.js';
import {make, short, trace} from './plot.js';

export class MapDistance {
  constructor(map) {
    Object.assign(this, {map, on: false, ends: [], words: make('p', {className: 'caption', role: 'status'})});
  }

  toggle(on = !this.on) {
    Object.assign(this, {on, ends: []});
    this.map.distanceButton.setAttribute('aria-pressed', String(on));
    this.map.canvas.classList.toggle('boxing', on);
    this.words.textContent = on ? 'Distance: click two points or positions (Enter: the middle of the map; Escape ends).' : '';
    this.map.draw();
  }

  async take(at) {
    const point = this.map.nearest(at), [x, y] = point ? this.map.placeOf(point) : this.map.toGround(at);
    this.ends = [...(this.ends.length > 1 ? [] : this.ends), {name: point || '', x, y}];
    this.map.draw();
    if (this.ends.length < 2) return;
    const [from, to] = this.ends, asked = new URLSearchParams({from: from.name, to: to.name, x0: from.x, y0: from.y, x1: to.x, y1: to.y});
    this.words.textContent = 'Computing the distance …';
    try {
      const found = await this.map.app.request(`/api/map/distance?${asked}`);
      this.words.textContent = `${from.name || 'Free position'} – ${to.name || 'free position'}: ${found.sentence}`;
      to.words = `${short(found.distance_m, 5)} m`;
    } catch (error) {
      this.words.textContent = error.message;
    }
    this.map.draw();
  }

  draw(pen) {
    const {context, x, y, moved, width, height} = pen, ends = this.ends.map(one => [x(one.x), y(one.y)]);
    if (!this.on) return;
    Object.assign(context, {strokeStyle: moved, lineWidth: 2});
    trace(context, ends);
    for (const [a, b] of [...ends, [width / 2, height / 2]]) for (const way of [1, -1]) trace(context, [[a - 6, b - 6 * way], [a + 6, b + 6 * way]]);
    if (this.ends[1]?.words) write(pen, this.ends[1].words, (ends[0][0] + ends[1][0]) / 2 + 6, (ends[0][1] + ends[1][1]) / 2 - 6);
  }
}
