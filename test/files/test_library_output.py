"""What libraries print past Python goes to the log."""

import logging
import os

from lunar_rover_sim.files.library_output import stderr_to_log


def test_the_terminal_sees_nothing_of_it(capfd, caplog):
    logger = logging.getLogger('lunar_rover_sim.test')
    with caplog.at_level(logging.INFO):
        with stderr_to_log(logger):
            os.write(2, b'one\xff\ntwo\n')
    assert [record.getMessage() for record in caplog.records] == ['one\ufffd', 'two']
    os.write(2, b'after\n')
    assert capfd.readouterr().err == 'after\n'


def test_an_error_passes_and_the_terminal_is_back(capfd):
    try:
        with stderr_to_log(logging.getLogger('lunar_rover_sim.test')):
            raise KeyError
    except KeyError:
        os.write(2, b'after\n')
    assert capfd.readouterr().err == 'after\n'
