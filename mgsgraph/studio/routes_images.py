"""Addresses of pictures, of what is drawn on them, of the ground under the cursor, and of the registration."""

from collections.abc import Callable

import numpy as np
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route

from mgsgraph.studio.ground import NoGround
from mgsgraph.studio.linked import ground_record
from mgsgraph.studio.registration import registration_record
from mgsgraph.studio.routes_figures import routes as figures
from mgsgraph.studio.views import Pictured, Views, number_of


def routes(scene: Pictured, views: Views | None = None) -> list[Route]:
    """Addresses of images, of the registration and of figures, for the server's list."""
    views = views or Views(scene)

    def tile(request: Request) -> Response:
        at = request.path_params
        asked = request.query_params
        low, high = (number_of(request.query_params, key) if key in asked else None for key in ("low", "high"))
        data = views.tiles.tile(at["name"], at["level"], at["row"], at["column"], low, high)
        return Response(data, media_type="image/png", headers={"Cache-Control": "private, max-age=86400"})

    def ground(request: Request) -> Response:
        wanted = [name for name in request.query_params.getlist("with") if name]
        linked = views.linked
        at = number_of(request.query_params, "line"), number_of(request.query_params, "sample")
        try:
            found, others = linked.under(request.path_params["name"], *at, wanted=wanted)
        except NoGround as error:  # no mistake of anybody's: limbs are looked at, too
            return JSONResponse({"sentence": str(error), "others": {}})
        record = ground_record(found, others, linked.block)
        record["map_m"] = np.asarray(scene.map_places(found.point[None]))[0].tolist()
        return JSONResponse(record)

    def image(request: Request) -> Response:
        return JSONResponse(views.image_record(request.path_params["name"]))

    def registration(_: Request) -> Response:
        minima = None if scene.solution is None else scene.solution.minima
        return JSONResponse(registration_record(views.linked.block, scene.folder, minima))

    every: list[tuple[str, Callable[[Request], Response]]] = [
        ("/api/images/{name:path}/tiles/{level:int}/{row:int}/{column:int}.png", tile),
        ("/api/images/{name:path}/ground", ground),
        ("/api/images/{name:path}", image),
        ("/api/registration", registration),
    ]
    return [*(Route(path, endpoint) for path, endpoint in every), *figures(scene, views)]
