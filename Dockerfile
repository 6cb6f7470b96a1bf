# prc in a container, for the user who builds it:
#
#   docker build --build-arg UID=$(id -u) -t prc .
#   docker run --rm -v "$PWD:/data" prc classify drive.laz drive_classified.laz
#
# The first stage builds the wheel. The second holds Python, the wheel with its libraries, and the compiled loops of this
# user, so that no run waits for the compiler. On another kind of processor, or as another user, they are compiled again.
FROM python:3.12-slim AS wheel
WORKDIR /src
COPY pyproject.toml README.md LICENSE ./
COPY prc_cli prc_cli
COPY sample_configs sample_configs
RUN pip wheel --no-cache-dir --no-deps --wheel-dir /wheels .

FROM python:3.12-slim
ARG UID=1000
COPY --from=wheel /wheels /wheels
RUN pip install --no-cache-dir "$(ls /wheels/*.whl)[crs,e57,ros]" && rm -r /wheels \
    && useradd --create-home --uid "$UID" prc \
    && mkdir /data && chown prc /data
USER prc
RUN prc demo --output /tmp/demo && rm -r /tmp/demo
WORKDIR /data
ENTRYPOINT ["prc"]
CMD ["--help"]
