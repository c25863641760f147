# docker build -t handcal .
# docker run --rm -v "$PWD:/data" --user "$(id -u)" handcal explain my-recording.mcap --report why.html

# The wheel, with machine code in it.
FROM python:3.12 AS build
# There is no git here: VERSION is what `git describe` says outside.
ARG VERSION=0.1.0.dev0
ENV SETUPTOOLS_SCM_PRETEND_VERSION=$VERSION
WORKDIR /build
COPY . .
RUN make dist PYTHON=python

FROM python:3.12-slim
COPY --from=build /build/dist/*.whl /build/constraints.txt /tmp/wheel/
RUN pip install --no-cache-dir --no-compile -c /tmp/wheel/constraints.txt \
        "$(ls /tmp/wheel/*.whl)[live,cloud]" \
    && rm -r /tmp/wheel
RUN useradd --create-home handcal
USER handcal
WORKDIR /data
ENTRYPOINT ["handcal"]
CMD ["--help"]
