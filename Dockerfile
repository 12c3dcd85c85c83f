# twc_env on the CPU, with compiled kernels, as a user without rights:
#   docker build -t twc_env . && docker run --rm -v "$PWD/runs:/home/robot/runs" twc_env explore --map twin-01
# On Linux the folder runs must be writable for user id 1000; or add --user "$(id -u):$(id -g)" to docker run.
FROM python:3.12-slim AS wheel
WORKDIR /source
COPY . .
RUN pip install --no-cache-dir build && python -m build --wheel --outdir /wheels

FROM python:3.12-slim
ARG EXTRAS=viz
COPY --from=wheel /source/constraints.txt /wheels/*.whl /tmp/
RUN pip install --no-cache-dir -c /tmp/constraints.txt "$(ls /tmp/*.whl)[${EXTRAS}]" && rm /tmp/*.whl
RUN useradd --create-home --uid 1000 robot
USER robot
WORKDIR /home/robot
ENV XDG_CACHE_HOME=/home/robot/.cache MPLBACKEND=Agg PYTHONDONTWRITEBYTECODE=
RUN twc-env warm-up && chmod -R a+rX /home/robot && mkdir -p runs
ENTRYPOINT ["twc-env"]
CMD ["--help"]
