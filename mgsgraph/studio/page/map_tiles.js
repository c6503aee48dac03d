// What lies under the map: tiles of orthorectified images and of relief, those of the level that suits the zoom, coarser
// ones while these are on their way.

import {Tiles} from './tile_layer.js';

const SIDE = 256, COARSER = [3, 2, 1];

export class MapTiles extends Tiles {
  constructor(map) {
    super(sentence => map.app.say(sentence, 'error'), () => map.draw());
    Object.assign(this, {map, asked: ''});
  }

  address(key) {
    const [level, row, column] = key.split('/');
    return `/api/map/tile.png?${new URLSearchParams({level, row, column, layers: this.layers, top: this.map.top.value})}`;
  }

  draw({context, x, y, density}) {
    const {map} = this, {shown, view, app} = map;
    this.layers = ['images', 'relief'].filter(layer => shown[layer]).join(',');
    const asked = `${app.scene.revision} ${this.layers} ${map.top.value}`;
    if (asked !== this.asked) {
      this.cancel();
      Object.assign(this, {asked, tiles: new Map(), failed: false});
    }
    if (!this.layers) return;
    const level = Math.max(-12, Math.min(24, Math.round(-Math.log2(view.scale * density))));
    const needed = this.keys(level), missing = needed.filter(one => !this.tiles.has(one.key));
    for (const one of [...(missing.length ? COARSER.flatMap(more => this.keys(level + more)) : []), ...needed]) {
      const tile = this.tiles.get(one.key);
      if (tile) context.drawImage(tile, x(one.west), y(one.north), one.step * view.scale + 0.5, one.step * view.scale + 0.5);
    }
    this.want(missing);
  }

  keys(level) {
    const step = SIDE * 2 ** level, [x0, y0, x1, y1] = this.map.box().map(one => Math.floor(one / step)), found = [];
    for (let row = y1; row >= y0; row--)
      for (let column = x0; column <= x1; column++)
        found.push({key: `${level}/${row}/${column}`, west: column * step, north: (row + 1) * step, step});
    return found;
  }
}
